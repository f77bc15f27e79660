"""How a network shows itself: as its notation, and in a notebook as its drawing."""

from __future__ import annotations


class Shown:
    """What every network has in common."""

    def __repr__(self) -> str:
        return f"parse({str(self)!r})"

    def _repr_html_(self) -> str:
        from base64 import b64encode

        from bayes_impedance.display import joined, lines
        from bayes_impedance.network.schematic import schematic
        from bayes_impedance.network.tree import Network

        assert isinstance(self, Network)  # every network is one
        # As a picture of its own: the rules of its style must not reach the notebook.
        drawing = schematic(self).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
        picture = b64encode(drawing.encode()).decode()
        return joined(
            f'<img alt="drawing of the network" src="data:image/svg+xml;base64,{picture}"/>', lines([str(self)])
        )
