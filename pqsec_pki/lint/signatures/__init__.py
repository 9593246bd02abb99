"""Rules about signed documents: their S/MIME form, and who signed them."""
