"""The stages of a study, each with a memory."""
