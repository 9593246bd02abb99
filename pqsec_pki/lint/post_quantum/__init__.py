"""Rules about post-quantum keys and signatures, and how stock stacks handle them."""
