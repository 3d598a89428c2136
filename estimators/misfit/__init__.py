"""How well a vector of parameters fits: free parameters, priors, losses, and kernels for many vectors at once."""
