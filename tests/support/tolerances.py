"""One table of tolerances: what rounding may do to a number of order one, per dtype."""

import torch

ROUNDING = {torch.float64: 1e-12, torch.float32: 1e-6}
SUM = {torch.float64: 1e-12, torch.float32: 2e-6}  # a kernel's few thousand values, added up
RENDERED = {torch.float64: 1e-12, torch.float32: 4e-6}  # a picture: transforms, sum, quotient
WHITE = 1e-5  # what the law of the white picture allows

# The oracle's kernels count 32 x 32 points a pixel: a level rim is half a row of them off at most,
# 1/64 of a pixel's share along one side.
OVERSAMPLING = 2e-3
