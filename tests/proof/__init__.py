"""A symbolic model of the handshake, proved by ProVerif; docs/proof/README.md describes it."""
