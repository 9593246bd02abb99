"""Rules about permissions: grants, their rules and times, and subject names."""
