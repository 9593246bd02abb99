"""Rules about governance: protection and access control of domains and topics."""
