"""GPU-accelerated robot learning from small composable parts: the meta-package and its command line."""
