"""What single variables of ``result.nc`` mean: attributes for readers of the file."""

from __future__ import annotations

from bayes_impedance.results.checked_predictions import MEANINGS
from bayes_impedance.results.pointwise import POINTWISE
from bayes_impedance.units import who

TAIL = "inverse_degrees_of_freedom"
"""Variable of the posterior of a Student t population, between 0 (normal) and 0.5."""
SHARE, DIFFERENCE = "second_group_share", "group_difference"
"""Variables of the posterior of a population of two groups."""
MEMBER = "second_group_probability"
"""Variable of the constant data: of each person, to belong to the second group."""


def meanings_of(unit: str, one_person: bool) -> dict[str, dict[str, str]]:
    """Attributes by variable, or by group and variable.

    Parameters
    ----------
    unit : str
        Of the impedance.
    one_person : bool
        Whether the log density is that of the only person, given the person's elements.
    """
    subjects = who(unit)
    person = "log elements of the subject" if one_person else "population parameters of the draw"
    described = (
        f"natural logarithm of the probability density of all complex values of one subject, given the {person}, with "
        "noise scale, elements and deviations between repetitions integrated out as far as they are not given; absolute"
    )
    density = {
        "long_name": "log density of a subject's recordings",
        "units": f"ln(density), density in ({unit})^-2 for every complex value",
        "description": described,
    }
    tail = {
        "long_name": f"reciprocal degrees of freedom of the distribution of {subjects}",
        "units": "1",
        "description": f"the log elements of {subjects} follow a multivariate Student t: 0 is the normal "
        "distribution, and at 0.5 the variance becomes infinite; dispersion_between_persons is its scale",
    }
    groups = {
        SHARE: {
            "long_name": f"share of {subjects} in the second group",
            "units": "1",
            "description": "two groups have one covariance; the second is the smaller one on average",
        },
        DIFFERENCE: {
            "long_name": "mean log elements of the second group less those of the first",
            "units": "1",
            "description": "mu and dispersion_between_persons are mean and standard deviation of both groups together",
        },
        MEMBER: {
            "long_name": "probability that the subject belongs to the second group",
            "units": "1",
            "description": "mean over posterior draws of the population and of the subject's elements",
        },
    }
    points = {
        "long_name": "log predictive density of a subject's recordings at one frequency, given its own elements",
        "units": density["units"],
        "description": "mean over posterior draws of the subject's elements, all repetitions together; absolute. The "
        "point took part in the estimate: for leave-one-out there is log_likelihood/recordings",
    }
    return MEANINGS | groups | {"log_likelihood/recordings": density, TAIL: tail, POINTWISE: points}
