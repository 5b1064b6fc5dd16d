"""Found by the kernels of the documentation instead of the real one: on a page there is nobody to move a slider.

The notebooks then show their picture at one value, as they do wherever ipywidgets is not installed.
"""

raise ImportError("a page has no kernel that a slider could reach")
