"""The problem with two basins: model, recordings and their source."""
