"""Blurred layers put together: saturating sum, views of the aperture, highlights, border."""
