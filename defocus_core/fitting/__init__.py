"""The lens that explains a pair: radii r = k (d₀ - d), affine in disparity."""
