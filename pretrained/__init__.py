"""Published policies, a directory each: weights (safetensors) and a card."""
