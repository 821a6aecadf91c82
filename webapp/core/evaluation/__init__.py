"""How good the answers are, measured against positions that are known."""
