"""Malformed datasets, descriptions, devices, populations, networks and options: each is a command.

A case is a name and a builder: it writes what it needs into a folder and returns the arguments of the command line.
Most must be refused (exit status 2, one line); those that are :func:`accepted` are odd, but can be used.
"""

from __future__ import annotations

import gzip
import json
import math
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

Builder = Callable[[Path], list[str]]

HEADER = "subject,repetition,frequency_hz,z_re,z_im"
POLAR_HEADER = "subject,repetition,frequency_hz,magnitude,phase_deg"
ROWS = [
    f"{who},{j},{f},{scale * (2 + 0.01 * j):.6g},{scale * (f * 0.02 - 60 / f):.6g}"
    for who, scale in (("A", 1.0), ("B", 1.3), ("C", 0.8))
    for j in (1, 2)
    for f in (5, 10, 20, 40, 80, 160, 320, 640)
]
GOOD = "\n".join([HEADER, *ROWS]) + "\n"
DEVICE = """name = "coil"
period_s = 5e-4
delay_s = 1e-4
[[section]]
arrangement = "beside"
network = "m1|r1"
values = {m1 = 0.03, r1 = 0.2}
"""
ELEMENT = {"central": 1.0, "dispersion_between_persons": 0.2, "dispersion_between_repetitions": 0.1}
TRUTH = {
    "network": "r1|m1",
    "elements": {"r1": ELEMENT, "m1": {**ELEMENT, "central": 1e-3}},
    "correlation": [["r1", "m1", 0.2]],
    "noise": {"relative_sd": 0.01, "corner_hz": 8.0},
}
BOMB_MEMBERS = 300
"""Members of a mebibyte of zeros each: more than is read of one file."""


def _write(file: Path, content: str | bytes) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


def dataset(folder: Path, content: str | bytes = GOOD, toml: str | bytes = "", subjects: str = "") -> Path:
    """A dataset's folder with these files."""
    _write(folder / "data" / "recordings.csv", content)
    if toml:
        _write(folder / "data" / "dataset.toml", toml)
    if subjects:
        _write(folder / "data" / "subjects.csv", subjects)
    return folder / "data"


def check(content: str | bytes, folder: Path, toml: str | bytes = "", subjects: str = "") -> list[str]:
    """Check a dataset."""
    return ["check", str(dataset(folder, content, toml, subjects))]


def run(folder: Path, *options: str, subjects: str = "") -> list[str]:
    """Run something that is refused before anything is sampled."""
    return ["run", str(dataset(folder, subjects=subjects)), "-o", str(folder / "out"), *options]


def with_network(network: str, folder: Path) -> list[str]:
    """Run with a network."""
    return run(folder, "--network", network)


def with_covariates(subjects: str, folder: Path) -> list[str]:
    """Run with the covariates a and b of a table."""
    return run(folder, "--network", "r1|m1|n1", "--covariate", "a", "--covariate", "b", subjects=subjects)


def device(content: str | bytes, folder: Path) -> list[str]:
    """Export with a device, which is read before the result."""
    return [
        "export",
        str(folder / "none"),
        "-o",
        str(folder / "out"),
        "--device",
        str(_write(folder / "d.toml", content)),
    ]


def population(content: object, folder: Path) -> list[str]:
    """Simulate a population of a file."""
    text = content if isinstance(content, str) else json.dumps(content)
    file = _write(folder / "truth.json", text)
    return ["simulate", "-o", str(folder / "out"), "--population", str(file), "--subjects", "2", "--points", "5"]


def simulate(*options: str) -> Builder:
    """Simulate with options."""
    return lambda folder: ["simulate", "-o", str(folder / "out"), *options]


def bare(*arguments: str) -> Builder:
    """Arguments as they are, with ``@`` for the folder."""
    return lambda folder: [a.replace("@", str(folder)) for a in arguments]


def cell(row: int, column: int, value: str, text: str = GOOD) -> str:
    """The good recordings with another cell; row 0 is the header."""
    lines = text.splitlines()
    cells = lines[row].split(",")
    cells[column] = value
    lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


def person(value: str) -> str:
    """Everybody's numbers of subject B replaced by one."""
    lines = [",".join([*line.split(",")[:3], value, value]) if line.startswith("B") else line for line in ROWS]
    return "\n".join([HEADER, *lines]) + "\n"


def bomb(folder: Path, name: str) -> Path:
    """A gzip file of a third of a megabyte that holds more than a quarter of a gigabyte."""
    return _write(folder / name, gzip.compress(bytes(2**20), 9) * BOMB_MEMBERS)


def _edited(path: tuple[str | int, ...], value: object) -> object:
    content = json.loads(json.dumps(TRUTH))
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return content


TABLES: dict[str, str | bytes] = {
    "empty": "",
    "only header": HEADER + "\n",
    "binary": bytes(range(256)) * 4,
    "null bytes": GOOD.replace("640", "6\x0040"),
    "utf-16": GOOD.encode("utf-16"),
    "latin-1": GOOD.replace("A,", "J\u00f6rg,").encode("latin-1"),
    "cut inside utf-8": GOOD.encode() + b"\xc3",
    "semicolons": GOOD.replace(",", ";"),
    "decimal commas": GOOD.replace(".", ","),
    "open quote": GOOD.replace("A,2,5", '"A,2,5'),
    "open quote and much text": GOOD.replace("A,2,5", '"A,2,5') + "x" * 200_000,
    "column twice": GOOD.replace("z_im", "z_re"),
    "no z_im": GOOD.replace("z_im", "imaginary"),
    "html": "<!DOCTYPE html><html><body>404</body></html>\n",
    "json": json.dumps(TRUTH),
    "short row": GOOD + "C,3,5,1\n",
    "cut in the last row": GOOD.rstrip("\n").rpartition(",")[0],
    "long row": GOOD + "C,3,5,1,1,1\n",
    "gzip cut short": gzip.compress(GOOD.encode())[:40],
    "gzip with rubbish behind": gzip.compress(GOOD.encode()) + b"rubbish",
    "gzip header only": b"\x1f\x8b",
    "gzip with another checksum": gzip.compress(GOOD.encode())[:-8] + bytes(8),
    "zlib": zlib.compress(GOOD.encode()),
    "control character in a name": cell(3, 0, "A\x1b[31m"),
    "conjugated sign": GOOD.replace(",2.", ",-2.").replace(",1.6", ",-1.6"),
    "two points each": "\n".join([HEADER, *(row for row in ROWS if row.split(",")[2] in ("5", "10"))]),
    "unsorted": "\n".join([HEADER, *reversed(ROWS)]),
    "same row twice": GOOD + ROWS[0] + "\n",
    "nothing but missing": "\n".join([HEADER, *(",".join([*row.split(",")[:3], "NaN", "NaN"]) for row in ROWS)]),
    "magnitude zero": f"{POLAR_HEADER}\nA,1,5,1,0\nA,1,6,0,0\nA,1,7,1,0\n",
    "magnitude below zero": f"{POLAR_HEADER}\nA,1,5,1,0\nA,1,6,-1,0\nA,1,7,1,0\n",
    "noise_sd of nothing": f"{HEADER},noise_sd\nA,1,5,1,0,1e-300\nA,1,6,1,0,1\nA,1,7,1,0,1\n",
    "noise_sd of everything": f"{HEADER},noise_sd\nA,1,5,1,0,1e300\nA,1,6,1,0,1\nA,1,7,1,0,1\n",
    "one person zero": person("0"),
    "one person 1e300": person("1e300"),
    "one person 1e-300": person("1e-300"),
}
CELLS = {
    "text": (3, "abc"),
    "underscore": (3, "1_000"),
    "decimal comma": (3, '"1,5"'),
    "formula": (3, "=1+1"),
    "1e300": (3, "1e300"),
    "1e38": (3, "1e38"),
    "1e161": (4, "-1e161"),
    "frequency zero": (2, "0"),
    "frequency negative": (2, "-5"),
    "frequency tiny": (2, "1e-300"),
    "frequency huge": (2, "1e300"),
    "frequency text": (2, "5 Hz"),
    "name empty": (0, ""),
}
METADATA: dict[str, str | bytes] = {
    "no toml": "title = ",
    "key twice": 'title = "a"\ntitle = "b"\n',
    "boolean title": "title = true\n",
    "number network": "network = 3\n",
    "list unit": 'unit = ["ohm"]\n',
    "table sign": "[sign]\nx = 1\n",
    "stiffness unit": 'unit = "N/m"\n',
    "long unit": f'unit = "{"x" * 5000}"\n',
    "unit with line breaks": 'unit = "N\\ns/m\\u001b[31m!"\n',
    "unknown sign": 'sign = "positive"\n',
    "5000 deep": "x = " + "[" * 5000 + "]" * 5000 + "\n",
    "5000 tables deep": "x = " + "{a = " * 5000 + "1" + "}" * 5000 + "\n",
    "huge integer": f"title = {'1' * 5000}\n",
    "hexadecimal integer": f"title = 0x{'f' * 9000}\n",
    "latin-1": 'title = "J\u00f6rg"\n'.encode("latin-1"),
    "binary": b"\x00\x01\x02",
    "larger than a description": "# " + "x" * 2**20 + "\n",
}
DEVICES: dict[str, str | bytes] = {
    "delay": DEVICE.replace("delay_s", "delay"),
    "periods": DEVICE.replace("period_s", "periods"),
    "no period": DEVICE.replace("period_s = 5e-4\n", ""),
    "boolean": DEVICE.replace("5e-4", "true"),
    "boolean value": DEVICE.replace("0.03", "true"),
    "nan": DEVICE.replace("5e-4", "nan"),
    "minus infinity": DEVICE.replace("1e-4", "-inf"),
    "period in ms": DEVICE.replace("5e-4", "0.5"),
    "text": DEVICE.replace("0.03", '"30 g"'),
    "section is a table": DEVICE.replace("[[section]]", "[section]"),
    "section is a number": "period_s = 1e-3\nsection = [3]\n",
    "no sections": "period_s = 1e-3\nsection = []\n",
    "values is a list": DEVICE.replace("{m1 = 0.03, r1 = 0.2}", "[0.03, 0.2]"),
    "no mass": DEVICE.replace("m1|r1", "r1").replace("m1 = 0.03, ", ""),
    "network 400 deep": DEVICE.replace("m1|r1", "(" * 400 + "m1" + ")" * 400),
    "5000 deep": "x = " + "[" * 5000 + "]" * 5000,
    "huge integer": DEVICE.replace("5e-4", "9" * 5000),
    "latin-1": DEVICE.replace("coil", "J\u00f6rg").encode("latin-1"),
    "empty": "",
}
POPULATIONS: dict[str, object] = {
    "empty": "",
    "a list": [],
    "a number": 3,
    "cut short": json.dumps(TRUTH)[:50],
    "5000 deep": "[" * 5000 + "]" * 5000,
    "50000 deep": '{"a":' * 50_000 + "1" + "}" * 50_000,
    "misspelt": {**{k: v for k, v in TRUTH.items() if k != "noise"}, "nois": {}},
    "no network": {k: v for k, v in TRUTH.items() if k != "network"},
    "huge integer": json.dumps(TRUTH).replace("0.001", "1" * 5000),
    "network": _edited(("network",), "r1||m1"),
    "central boolean": _edited(("elements", "r1", "central"), True),
    "central negative": _edited(("elements", "r1", "central"), -1),
    "central nan": _edited(("elements", "r1", "central"), math.nan),
    "central huge": _edited(("elements", "r1", "central"), 1e300),
    "dispersion negative": _edited(("elements", "r1", "dispersion_between_persons"), -1),
    "dispersion huge": _edited(("elements", "r1", "dispersion_between_persons"), 1e3),
    "correlation of two": _edited(("correlation",), [["r1", "m1", 2.0]]),
    "correlation of nobody": _edited(("correlation",), [["r1", "q", 0.1]]),
    "correlation text": _edited(("correlation",), "none"),
    "noise negative": _edited(("noise", "relative_sd"), -1),
    "noise misspelt": _edited(("noise", "relative"), 0.1),
}
NETWORKS = {
    "empty": "",
    "unfinished": "m1|",
    "unknown kind": "m1|k1",
    "twice": "m1|n1|m1",
    "400 deep": "(" * 400 + "m1" + ")" * 400,
    "400 levels": "(r1-" * 400 + "m1" + ")" * 400,
    "400 labels": "a:" * 400 + "m1",
    "60 elements": "|".join(f"(n{i}-r{i})" for i in range(30)),
    "100000 characters": "m1|" * 33_000 + "m1",
    "line break": "m1|\nk1",
    "escape codes": "m1|\x1b[31m",
    "not ascii": "m1|\u03a9",
}
OPTIONS: dict[str, Builder] = {
    "nothing": bare(),
    "unknown command": bare("simulat"),
    "no dataset": bare("check"),
    "dataset that is not there": bare("check", "@/none"),
    "empty folder": bare("check", "@"),
    "noise nan": simulate("--noise", "nan"),
    "noise -1": simulate("--noise", "-1"),
    "noise inf": simulate("--noise", "inf"),
    "noise 1e300": simulate("--noise", "1e300"),
    "noise text": simulate("--noise", "one\npercent"),
    "band inf": simulate("--band", "1", "inf"),
    "band nan": simulate("--band", "nan", "10"),
    "band zero": simulate("--band", "0", "10"),
    "band backwards": simulate("--band", "10", "5"),
    "band of no width": simulate("--band", "5", "5.0000000000001"),
    "points 2": simulate("--points", "2"),
    "points 1e3": simulate("--points", "1e3"),
    "subjects 0": simulate("--subjects", "0"),
    "subjects of 5000 digits": simulate("--subjects", "9" * 5000),
    "too many numbers": simulate("--subjects", "1000000", "--points", "100000"),
    "seed of 38 digits": simulate("--seed", "1" * 38),
    "seed negative": simulate("--seed", "-1"),
    "population that is not there": simulate("--population", "none.json"),
    "seed of a run": bare("run", "@/none", "--seed", "1" * 38),
    "workers": bare("fit", "@/none", "--workers", "10000000"),
    "workers zero": bare("diagnose", "@/none", "--workers", "0"),
    "covariance": bare("fit", "@/none", "--covariance", "half"),
    "share 2": bare("export", "@/none", "--share", "2"),
    "share nan": bare("export", "@/none", "--share", "nan"),
    "damping inf": bare("export", "@/none", "--damping", "inf"),
    "damping negative": bare("export", "@/none", "--damping", "-1"),
    "grid 1": bare("export", "@/none", "--grid", "1"),
    "grid 100000": bare("export", "@/none", "--grid", "100000"),
    "users 1e12": bare("export", "@/none", "--users", "1000000000000"),
    "assume nan": bare("export", "@/none", "--assume", "n3=nan"),
    "assume negative": bare("export", "@/none", "--assume", "n3=-1"),
    "assume twice": bare("export", "@/none", "--assume", "n3=1", "--assume", "n3=2"),
    "assume without a name": bare("export", "@/none", "--assume", "=1"),
    "device that is not there": bare("export", "@/none", "--device", "@/none.toml"),
    "device that is a folder": bare("export", "@/none", "--device", "@"),
    "gzip bomb": lambda folder: ["check", str(bomb(folder, "recordings.csv.gz").parent)],
    "gzip bomb as description": lambda folder: [
        "check",
        str(bomb(dataset(folder), "dataset.toml").parent),
    ],
}
COVARIATES = {
    "collinear": "subject,a,b\nA,1,2\nB,2,4\nC,4,8\n",
    "as many as people": "subject,a,b\nA,1,5\nB,2,4\nC,4,2.9\n",
    "one is 1e300": "subject,a,b\nA,1,1\nB,2,7\nC,1e300,2\n",
    "text": "subject,a,b\nA,1,x\nB,2,y\nC,3,z\n",
    "missing": "subject,a,b\nA,1,\nB,2,7\nC,3,2\n",
    "constant": "subject,a,b\nA,1,1\nB,1,7\nC,1,2\n",
    "subject twice": "subject,a,b\nA,1,1\nA,2,7\nC,3,2\nB,1,1\n",
    "nobody": "subject,a,b\nX,1,1\n",
}

CASES: list[tuple[str, Builder]] = [
    *((f"table: {name}", partial(check, content)) for name, content in TABLES.items()),
    *((f"cell: {name}", partial(check, cell(5, column, value))) for name, (column, value) in CELLS.items()),
    ("cell: 1e-300 both", partial(check, cell(5, 3, "1e-300", cell(5, 4, "1e-300")))),
    ("cell: zero both", partial(check, cell(5, 3, "0", cell(5, 4, "0")))),
    *((f"dataset.toml: {name}", partial(check, GOOD, toml=toml)) for name, toml in METADATA.items()),
    *((f"device: {name}", partial(device, content)) for name, content in DEVICES.items()),
    *((f"population: {name}", partial(population, content)) for name, content in POPULATIONS.items()),
    *((f"network: {name}", partial(with_network, network)) for name, network in NETWORKS.items()),
    *((f"option: {name}", builder) for name, builder in OPTIONS.items()),
    *((f"covariates: {name}", partial(with_covariates, subjects)) for name, subjects in COVARIATES.items()),
]

CASES += [
    (f"accepted: {name}", builder)
    for name, builder in {
        "unknown keys": partial(check, GOOD, toml='titel = "T"\nnetwork = "m1|"\n[import]\nfrom = "x"\n'),
        "sentinel 9999": partial(check, cell(5, 3, "9999")),
        "sentinel 1e20 twice": partial(check, cell(5, 3, "1e20", cell(6, 3, "1e20"))),
        "zero in one column": partial(check, cell(5, 3, "0", cell(6, 3, "0"))),
        "one cell empty": partial(check, cell(5, 3, "")),
        "infinite cell": partial(check, cell(5, 3, "1e400")),
        "one person 9999": partial(check, person("9999")),
        "subjects that nobody measured": partial(check, GOOD, subjects="subject,a\nA,1\nB,2\nC,3\nD,4\n"),
        "covariate 1e300": partial(check, GOOD, subjects="subject,a\nA,1\nB,2\nC,1e300\n"),
        "gzip of two members": partial(
            check, gzip.compress(GOOD[:100].encode()) + gzip.compress(GOOD[100:].encode()) + bytes(512)
        ),
        "byte order mark": partial(check, b"\xef\xbb\xbf" + GOOD.encode()),
        "a good population": partial(population, TRUTH),
        "no noise": simulate("--noise", "0", "--subjects", "1", "--repetitions", "1", "--points", "3"),
    }.items()
]


def accepted(name: str) -> bool:
    """Whether a case is odd but can be used."""
    return name.startswith("accepted: ")
