"""The lens that explains a pair of pictures: radii r = k (d₀ - d), affine in disparity d."""
