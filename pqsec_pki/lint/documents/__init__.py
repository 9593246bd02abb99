"""Rules about what governance and permissions have in common: XML, values, patterns."""
