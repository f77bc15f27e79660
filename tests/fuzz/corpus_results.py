"""Damaged results, each a function that damages a copy of a finished fit."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

Damage = Callable[[Path], None]
NC, JSON = "result.nc", "summary.json"


def cut(name: str, share: float) -> Damage:
    """Only a part of the file is left."""

    def damage(folder: Path) -> None:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(share * len(content))])

    return damage


def flipped(name: str, seed: int, bits: int = 40) -> Damage:
    """Some bits are wrong; in a netCDF file, also where nothing is stored."""

    def damage(folder: Path) -> None:
        content, rng = bytearray((folder / name).read_bytes()), random.Random(seed)
        for _ in range(bits):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
        (folder / name).write_bytes(bytes(content))

    return damage


def holding(name: str, content: bytes) -> Damage:
    """The file holds something else."""
    return lambda folder: (folder / name).write_bytes(content) and None


def zeros(name: str, start: float, end: float) -> Damage:
    """A block that was never written."""

    def damage(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        first, last = int(start * len(content)), int(end * len(content))
        content[first:last] = bytes(last - first)
        (folder / name).write_bytes(bytes(content))

    return damage


def changed(change: Callable[[dict[str, Any]], Any]) -> Damage:
    """The summary was edited."""

    def damage(folder: Path) -> None:
        summary = json.loads((folder / JSON).read_text(encoding="utf-8"))
        change(summary)
        (folder / JSON).write_text(json.dumps(summary), encoding="utf-8")

    return damage


def gone(name: str) -> Damage:
    """The file is not there."""
    return lambda folder: (folder / name).unlink()


def folder_instead(name: str) -> Damage:
    """A folder has its name."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).mkdir()

    return damage


def link_to_itself(name: str) -> Damage:
    """A link that leads nowhere."""

    def damage(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(folder / name)

    return damage


def hdf5(build: Callable[[Any], None]) -> Damage:
    """An HDF5 file of another kind."""

    def damage(folder: Path) -> None:
        import h5py

        with h5py.File(folder / NC, "w") as file:
            build(file)

    return damage


def edited(edit: Callable[[Any], None]) -> Damage:
    """The netCDF file was changed by another program."""

    def damage(folder: Path) -> None:
        import h5py

        with h5py.File(folder / NC, "r+") as file:
            edit(file)

    return damage


def _one_number(file: Any) -> None:
    file["posterior/mu"][0, 0, 0] += 1e-9


def _attribute(name: str, value: Any) -> Callable[[Any], None]:
    return lambda file: file["posterior"].attrs.__setitem__(name, value)


def _without(path: str) -> Callable[[Any], None]:
    return lambda file: file.__delitem__(path)


RESULTS: dict[str, Damage] = {
    **{f"{name} cut to {share}": cut(name, share) for name in (NC, JSON) for share in (0.0, 0.001, 0.3, 0.9, 0.999)},
    **{f"{NC} with wrong bits {seed}": flipped(NC, seed) for seed in range(8)},
    **{f"{JSON} with wrong bits {seed}": flipped(JSON, seed) for seed in range(4)},
    **{f"{name} is a folder": folder_instead(name) for name in (NC, JSON)},
    **{f"{name} is a link to itself": link_to_itself(name) for name in (NC, JSON)},
    **{f"{name} is gone": gone(name) for name in (NC, JSON)},
    **{f"{name} has a hole": zeros(name, 0.2, 0.6) for name in (NC, JSON)},
    "no HDF5": holding(NC, b"subject,frequency_hz\n"),
    "HDF5's signature alone": holding(NC, b"\x89HDF\r\n\x1a\n"),
    "HDF5 without groups": hdf5(lambda file: None),
    "a posterior without anything": hdf5(lambda file: file.create_group("posterior")),
    "a posterior that is an array": hdf5(lambda file: file.create_dataset("posterior", data=[1.0])),
    "a seal and nothing else": hdf5(lambda f: f.create_group("posterior").attrs.update(content_sha256="0" * 64)),
    "one number changed": edited(_one_number),
    "a variable taken out": edited(_without("posterior/mu")),
    "a group taken out": edited(_without("constant_data")),
    "another seed in the attributes": edited(_attribute("seed", 17)),
    "another network in the attributes": edited(_attribute("network", "m1|r1")),
    "a seal that is a number": edited(_attribute("content_sha256", 3.0)),
    "summary: empty object": holding(JSON, b"{}"),
    "summary: list": holding(JSON, b"[1, 2]"),
    "summary: null": holding(JSON, b"null"),
    "summary: text": holding(JSON, b'"summary"'),
    "summary: not UTF-8": holding(JSON, '{"title": "\xe4"}'.encode("latin-1")),
    "summary: byte order mark": holding(JSON, b"\xef\xbb\xbf{}"),
    "summary: very deep": holding(JSON, b'{"a":' * 100_000),
    "summary: a number of 5000 digits": holding(JSON, b'{"seed": ' + b"9" * 5000 + b"}"),
    "summary: NaN": holding(JSON, b'{"seed": NaN}'),
    "summary: binary": holding(JSON, bytes(range(256))),
    "summary: other seed": changed(lambda s: s.update(seed=2)),
    "summary: other data": changed(lambda s: s.update(data_sha256="0" * 64)),
    "summary: other network": changed(lambda s: s.update(network="m1|r1")),
    "summary: no elements": changed(lambda s: s.pop("elements")),
    "summary: elements a list": changed(lambda s: s.update(elements=[])),
    "summary: a value changed": changed(lambda s: s["elements"]["m1"]["central"].update(median=1.0)),
    "summary: a value a text": changed(lambda s: s["elements"]["m1"].update(central="1e-4")),
    "summary: problems taken out": changed(lambda s: s.pop("problems")),
    "summary: schema 99": changed(lambda s: s.update(schema=99)),
    "summary: sampler null": changed(lambda s: s.update(sampler=None)),
}
"""Every one of these must be refused with one sentence."""

_VALUES = ("central", "dispersion_between_persons", "dispersion_between_repetitions")

POPULATIONS: dict[str, Any] = {
    "elements is a list": {"network": "m1", "elements": [], "correlation": []},
    "elements is a number": {"network": "m1", "elements": 3, "correlation": []},
    "a central value is a list": {"network": "m1", "elements": {"m1": {"central": [1]}}, "correlation": []},
    "an element is a text": {"network": "m1", "elements": {"m1": "big"}, "correlation": []},
    "noise is a list": {"network": "m1", "elements": {}, "correlation": [], "noise": [1]},
    "noise is a text": {"network": "m1", "elements": {}, "correlation": [], "noise": {"relative_sd": "much"}},
    "correlation is a number": {"network": "m1", "elements": {}, "correlation": 1},
    "correlation of strangers": {
        "network": "m1",
        "elements": {
            "m1": dict.fromkeys(("central", "dispersion_between_persons", "dispersion_between_repetitions"), 1.0)
        },
        "correlation": [["m1", "n7", 0.5]],
    },
    "the network is no network": {"network": "((", "elements": {}, "correlation": []},
    "the network has other elements": {"network": "m1|r1", "elements": {}, "correlation": []},
    "a value of 400 digits": {"network": "m1", "elements": {"m1": {"central": 10**400}}, "correlation": []},
}
"""Descriptions of populations that describe none."""
