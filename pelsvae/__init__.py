"""How a surrogate learns: the physics-enhanced latent space variational autoencoder (PELS-VAE)."""
