"""What MLflow shows, and where a number comes from."""
