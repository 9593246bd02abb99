"""Rules about certificates, their keys and revocation lists, each by itself."""
