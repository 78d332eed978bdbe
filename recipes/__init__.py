"""Recipes: one file a variant, each shows its chain as a list and trains it when run as a script."""
