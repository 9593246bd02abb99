"""Rules about one enclave: its files, which must match each other."""
