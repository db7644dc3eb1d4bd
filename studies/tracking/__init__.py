"""What MLflow is told, and where a number comes from."""
