"""Rules about the configuration of stacks."""
