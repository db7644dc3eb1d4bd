"""What users read: lines on the terminal, and numbers, units and moments as text."""
