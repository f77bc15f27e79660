"""What comes with the package: virtual recordings, the population that was estimated of them, and published curves.

Input: nothing. Output: recordings, a finished fit and its population, and values from publications
(:mod:`.published_sets`). Open :mod:`.shipped` first.
"""

from bayes_impedance.datasets.published_sets import PublishedSet, PublishedValue, published_set, published_values
from bayes_impedance.datasets.shipped import (
    SHIPPED,
    fingertip_folder,
    fingertip_population,
    fingertip_recordings,
    fingertip_result,
    folder_of,
    published_curves,
)

__all__ = [
    "SHIPPED",
    "PublishedSet",
    "PublishedValue",
    "fingertip_folder",
    "fingertip_population",
    "fingertip_recordings",
    "fingertip_result",
    "folder_of",
    "published_curves",
    "published_set",
    "published_values",
]
