"""Running FMUs: descriptions, instances, co-simulation, model exchange."""
