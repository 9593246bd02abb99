"""Rules about a whole keystore or folder: what enclaves share, and files on disk."""
