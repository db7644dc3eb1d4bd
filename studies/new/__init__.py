"""A case file from what an FMU says about itself."""
