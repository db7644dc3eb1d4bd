"""What stages come to: typed records, what made them, and their files."""
