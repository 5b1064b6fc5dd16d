"""The least error that any estimator can guarantee, over a box of plants or along a plant that varies."""
