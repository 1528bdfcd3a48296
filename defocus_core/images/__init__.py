"""Pictures as tensors and windows of them: tiling, pyramids, resampling, neighbourhoods."""
