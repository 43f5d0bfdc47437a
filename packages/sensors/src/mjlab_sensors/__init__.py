"""Native, contact and terrain-height sensors over batched MuJoCo worlds."""
