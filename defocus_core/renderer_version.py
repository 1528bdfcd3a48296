"""The version of the renderer. Raise it when pictures change.

Batches render again the pictures that an earlier version rendered. tests/laws/test_golden.py fails
if pictures change and the number does not. The module imports nothing, so that planning a batch
does not load torch.
"""

RENDERER_VERSION = 23
