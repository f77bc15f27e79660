"""One impedance in files of many kinds, written by the libraries that others use."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, table
from simulated_signals import Multisine

F, Z = FREQUENCY, impedance()
S = 2j * np.pi * F
SINES = Multisine()


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes
    ----------
    file : name of the file
    write : writes it
    options : of the command
    precision : relative, of the numbers in the file
    signals : whether it holds the signals of a multisine instead of the spectrum
    """

    file: str
    write: Callable[[Path], None]
    options: tuple[str, ...] = ()
    precision: float = 1e-12
    signals: bool = False


def text(content: str, encoding: str = "utf-8") -> Callable[[Path], None]:
    def write(file: Path) -> None:
        file.write_bytes(content.encode(encoding))

    return write


def signals(count: int = 4) -> tuple[np.ndarray, np.ndarray]:
    force, x = SINES.periods(count, 1)
    return force.ravel(), x.ravel()


def xlsx(file: Path) -> None:
    book = pytest.importorskip("openpyxl").Workbook()
    book.active.append(["Frequency (Hz)", "Re (m/s/N)", "Im (m/s/N)"])
    for f, h in zip(F.tolist(), (1 / Z).tolist(), strict=True):
        book.active.append([f, h.real, h.imag])
    book.save(file)


def mat(file: Path) -> None:
    from scipy.io import savemat

    savemat(file, {"freq": F, "H": S / Z, "note": "made by a test"})


def mat_signals(file: Path) -> None:
    from scipy.io import savemat

    force, x = signals()
    savemat(file, {"daq": {"force": force, "x": x, "fs": SINES.rate_hz}})


def mat73(file: Path) -> None:
    import h5py

    with h5py.File(file, "w", userblock_size=512) as content:
        content["freq"] = F[None]
        content["Z"] = np.rec.fromarrays([Z.real[None], Z.imag[None]], names="real,imag")
    with file.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(116))


def uff(binary: int) -> Callable[[Path], None]:
    def write(file: Path) -> None:
        pyuff = pytest.importorskip("pyuff")
        for node, value in ((2, 3 * S / Z), (1, S / Z)):
            data = pyuff.prepare_58(
                binary=binary,
                func_type=4,
                rsp_node=node,
                rsp_dir=3,
                ref_node=1,
                ref_dir=3,
                rsp_ent_name="A",
                ref_ent_name="A",
                abscissa_spacing=0,
                abscissa_spec_data_type=18,
                ordinate_spec_data_type=12,
                orddenom_spec_data_type=13,
                data=value,
                x=F,
                id1="a test",
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ResourceWarning)  # its writer of binary sets leaves a file open
                pyuff.UFF(str(file)).write_sets(data, "add")

    return write


def touchstone(file: Path) -> None:
    reflection = (Z - 50) / (Z + 50)
    rows = [f"{f!r} {s.real!r} {s.imag!r}" for f, s in zip((F / 1e3).tolist(), reflection.tolist(), strict=True)]
    file.write_text("\n".join(["! made by a test", "# kHz S RI R 50", *rows]), encoding="utf-8")


def lvm(file: Path) -> None:
    force, x = signals()
    head = [
        "LabVIEW Measurement\t",
        "Separator\tTab",
        "Decimal_Separator\t,",
        "X_Columns\tNo",
        "***End_of_Header***\t",
        "",
    ]
    head += ["Channels\t2\t\t", f"Samples\t{force.size}\t{force.size}\t", "Y_Unit_Label\tNewtons\tmm\t"]
    head += [
        "X0\t0,0\t0,0\t",
        "Delta_X\t5,0E-4\t5,0E-4\t",
        "***End_of_Header***\t\t\t",
        "X_Value\tForce\tMotion\tComment",
    ]
    rows = [f"\t{a!r}\t{b!r}".replace(".", ",") for a, b in zip(force.tolist(), (1e3 * x).tolist(), strict=True)]
    file.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")


def wav(file: Path) -> None:
    force, x = signals()
    scaled = np.stack([force / 100, x / 0.01], axis=1)
    assert np.abs(scaled).max() < 1
    pytest.importorskip("soundfile").write(file, scaled, int(SINES.rate_hz), subtype="DOUBLE")


def tdms(file: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    force, x = signals()
    with nptdms.TdmsWriter(file) as writer:
        for name, values, unit in (("force", force, "N"), ("motion", x, "m")):
            properties = {"wf_increment": 1 / SINES.rate_hz, "unit_string": unit}
            writer.write_segment([nptdms.ChannelObject("measured", name, values, properties=properties)])


def npz_signals(file: Path) -> None:
    force, x = signals()
    np.savez(file, force=force, x=x, fs=SINES.rate_hz)


def rows(columns: dict[str, np.ndarray], separator: str) -> list[str]:
    return table(columns, separator).splitlines()[1:]


EXTRA = {"time": F, "zsig": F, "zmod": abs(Z)}
GAMRY_HEAD = """EXPLAIN
TAG\tEISPOT
ZCURVE\tTABLE\t25
\tPt\tFreq\tZreal\tZimag\tTime\tZsig\tZmod
\t#\tHz\tohm\tohm\ts\tV\tohm
\t"""
GAMRY = GAMRY_HEAD + "\n\t".join(rows({"p": F * 0, "f": F, "re": Z.real, "im": Z.imag, **EXTRA}, "\t"))
BIOLOGIC_HEAD = """EC-Lab ASCII FILE
Nb header lines : 4
Technique : Impedance, µA
freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\ttime/s\t|Z|/Ohm\tcycle number
"""
BIOLOGIC = BIOLOGIC_HEAD + "\n".join(rows({"f": F, "re": Z.real, "im": -Z.imag, **EXTRA}, "\t"))
ZVIEW_HEAD = """"ZPLOT2 ASCII"
"Date:  1-2-2024"
"End Comments"
"  Freq(Hz)","Ampl","Bias","Z'(a)","Z''(b)","GD"
"""
ZVIEW = ZVIEW_HEAD + "\n".join(rows({"f": F, "a": F, "b": F, "re": Z.real, "im": Z.imag, "g": F}, ","))
AUTOLAB = "Frequency (Hz);Z' (Ω);-Z'' (Ω);Z (Ω);-Phase (°)\n" + "\n".join(
    r.replace(".", ",") for r in rows({"f": F, "re": Z.real, "im": -Z.imag, "m": abs(Z), "p": F}, ";")
)
POLAR = {"f [Hz]": F, "|H| [dB]": 20 * np.log10(abs(1e-3 * Z)), "arg(H) [rad]": np.angle(Z)}
COMPLIANCE = {"f [kHz]": F / 1e3, "Re(H) [mm/N]": 1e3 * (1 / S / Z).real, "Im(H) [mm/N]": 1e3 * (1 / S / Z).imag}
IN_G = {"f": F, "re": (S / Z).real / 9.80665, "im": (S / Z).imag / 9.80665}
IN_TIME = {"time [ms]": np.arange(4000) / 2, "F [N]": signals()[0], "x [µm]": 1e6 * signals()[1]}
NAMED = ("--columns", "frequency=f", "complex=apparent_mass", "--unit", "kg")
SCALED = ("--force", "channel 1@0.01 1/N", "--motion", "channel 2@100 1/m")
CHANNELS = ("--force", "daq.force[N]", "--motion", "daq.x[m]")

KINDS = {
    "CSV of a dataset": Kind("a.csv", text(table({"frequency_hz": F, "z_re": Z.real, "z_im": Z.imag}))),
    "tabs": Kind("a.tsv", text(table({"f_hz": F, "re_z": Z.real, "im_z": Z.imag}, "\t"))),
    "semicolons, decimal commas, UTF-16": Kind("a.txt", text(table(COMPLIANCE, ";", ","), "utf-16"), precision=1e-11),
    "magnitude in dB and phase": Kind("a.csv", text(table(POLAR)), ("--unit", "N s/mm"), 1e-11),
    "accelerance in g/N": Kind("a.csv", text(table(IN_G)), ("--unit", "g/N")),
    "xlsx": Kind("a.xlsx", xlsx),
    "MATLAB 5": Kind("a.mat", mat, ("--form", "accelerance")),
    "MATLAB 7.3": Kind("a.mat", mat73),
    "MATLAB, signals in a structure": Kind("a.mat", mat_signals, CHANNELS, 1e-9, signals=True),
    "NumPy": Kind("a.npz", lambda file: np.savez(file, f=F, apparent_mass=Z / S), NAMED),
    "NumPy, signals": Kind("a.npz", npz_signals, ("--force", "force[N]", "--motion", "x[m]"), 1e-9, signals=True),
    "UFF 58, ASCII": Kind("a.uff", uff(0), precision=1e-5),
    "UFF 58, binary": Kind("a.uff", uff(1)),
    "Touchstone": Kind("a.s1p", touchstone, precision=1e-10),
    "LabVIEW": Kind("a.lvm", lvm, precision=1e-9, signals=True),
    "sound": Kind("a.wav", wav, SCALED, 1e-9, signals=True),
    "TDMS": Kind("a.tdms", tdms, precision=1e-9, signals=True),
    "Gamry": Kind("a.DTA", text(GAMRY)),
    "BioLogic": Kind("a.mpt", text(BIOLOGIC, "cp1252")),
    "ZView": Kind("a.z", text(ZVIEW)),
    "Autolab": Kind("a.txt", text(AUTOLAB)),
    "signals as text": Kind("a.csv", text(table(IN_TIME)), precision=1e-9, signals=True),
}
