"""A virtual world for fingertips and the rig that measures them, from first principles.

Nothing of the package's network, elements, kernel, operations or catalogue is used; the lumped finger is the formula of
``people.py``. With nothing switched on, the recordings are exactly those of the lumped finger with noise.
"""
