"""Error and time of the renderer on scenes with known truth, and time on synthetic scenes.

Terms: a shot is one lens of a scene with known truth; a method is a quality or a baseline method; a
case is a synthetic scene to time at one size, radius and quality.
"""
