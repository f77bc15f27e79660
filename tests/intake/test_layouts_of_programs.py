"""Text as programs really lay it out: other tables before the spectrum, names and rows that end or part differently."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings

F, Z = FREQUENCY[::-1], impedance()[::-1]


def lines(form: str) -> str:
    """Rows of frequency, real and imaginary part, magnitude and phase, from the highest frequency down."""
    return "".join(
        form.format(i=i, f=f, re=z.real, im=z.imag, neg=-z.imag, mag=abs(z), phase=np.angle(z, deg=True))
        for i, (f, z) in enumerate(zip(F.tolist(), Z.tolist(), strict=True))
    )


GAMRY = (
    "EXPLAIN\nTAG\tEISPOT\nNOTES\tNOTES\t2\t&Notes...\n\t-50mV 5.66X10^-4\n\t\n"
    "VDC\tPOTEN\t-5.0E-002\tT\tDC &Voltage (V)\n"
    "OCVCURVE\tTABLE\t387\n\tPt\tT\tVf\tVm\tAch\tOver\tTemp\n\t#\ts\tV vs. Ref.\tV\tV\tbits\tdeg C\n"
    + "".join(f"\t{i}\t{i * 0.25}\t-3.4E-001\t-3.4E-001\t-5.5E-004\t..........a\t-327.67\n" for i in range(387))
    + "EOC\tQUANT\t-0.34\tOpen Circuit (V)\nZCURVE\tTABLE\n\tPt\tTime\tFreq\tZreal\tZimag\tZsig\tZmod\tZphz\tIdc\n"
    "\t#\ts\tHz\tohm\tohm\tV\tohm\t°\tA\n" + lines("\t{i}\t{i}\t{f}\t{re}\t{im}\t1\t{mag}\t{phase}\t-2.5E-006\n")
)
BIOLOGIC = (
    "EC-Lab ASCII FILE\nNb header lines : 61       \n\nRun on channel : 1\nE (V)               0.0000    \n\n"
    "freq/Hz\tRe(Z)/Ohm\t-Im(Z)/Ohm\t|Z|/Ohm\tPhase(Z)/deg\ttime/s\t<Ewe>/V\tCs/µF\tRe(Y)/Ohm-1\t\n"
    + lines("{f}\t{re}\t{neg}\t{mag}\t{phase}\t1.0\t-2.9E-004\t4.1E+002\t1.5E-002\n")
)
Z60W = (
    '"Z60W Data File: Version 1.1"\n""\n""\n0,2,0,1,0.1,10000\n41\n'
    "\"  Freq (Hz)    Ampl     Bias   Time(Sec)   Z'(a)    Z''(b)    GD   Err   Range\"\n"
    + lines("{f},0,0,0,{re},{im},0,0,0\n")
)
ZPLOT = (
    "ZPLOT2 ASCII\n  Measured Data, ZPlot:       3.2c\n    Calibration File\n"
    "  Null Configuration:         0,3,0,1,300000,1\n"
    "  Freq(Hz)\tAmpl\tBias\tTime(Sec)\tZ'(a)\tZ''(b)\tGD\tErr\tRange\nEnd Comments\n"
    + lines("{f}\t1.0E-02\t0.0E+00\t2.67\t{re}\t{im}\t0.0E+00\t0\t3\n")
)
CHI = (
    "Feb. 20, 2020   15:55:08\nA.C. Impedance\nHeader: \n\nHigh Frequency (Hz) = 2e+6\n\n"
    "Freq/Hz, Z'/ohm, Z\"/ohm, Z/ohm, Phase/deg\n\n" + lines("{f}, {re}, {im}, {mag}, {phase}\n")
)
ENDED = "f [Hz],Re(Z) [ohm],Im(Z) [ohm]\n" + lines("{f},{re},{im},\n")
LAYOUTS = {
    "a.DTA": GAMRY,
    "aborted.DTA": GAMRY + "EXPERIMENTABORTED\tTOGGLE\tT\tExperiment Aborted\n",
    "a.mpt": BIOLOGIC,
    "comma.mpt": BIOLOGIC.replace(".", ","),
    "z60w.txt": Z60W,
    "a.z": ZPLOT,
    "chi.txt": CHI,
    "ended.csv": ENDED,
}


@pytest.mark.parametrize("name", LAYOUTS)
@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_the_spectrum_is_found(name: str, encoding: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(LAYOUTS[name], encoding=encoding)
    assert main(["import", str(tmp_path / name), "-o", str(tmp_path / "out")]) == 0
    found = read_recordings(tmp_path / "out")
    assert found.unit == "ohm"
    np.testing.assert_allclose(found.subjects[0].frequency_hz, F[::-1])
    np.testing.assert_allclose(found.subjects[0].z[0], Z[::-1], rtol=1e-12)


def test_rows_keep_their_numbers_where_another_table_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = GAMRY[: GAMRY.rindex("\t", 0, -30)]
    (tmp_path / "a.DTA").write_text(cut + "\n", encoding="utf-8")
    assert main(["import", str(tmp_path / "a.DTA"), "-o", str(tmp_path / "out")]) == 2
    assert f"a.DTA, row {GAMRY.count(chr(10))}: there are" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("prefix", ["", "data.", "measured.left."])
def test_fields_of_a_structure_are_known_by_their_own_names(prefix: str, tmp_path: Path) -> None:
    import scipy.io

    content: dict[str, object] = {"freq": F, "FRF": 1 / Z}
    for name in reversed([part for part in prefix.split(".") if part]):
        content = {name: content}
    scipy.io.savemat(tmp_path / "a.mat", content)
    assert main(["import", str(tmp_path / "a.mat"), "-o", str(tmp_path / "out"), "--form", "mobility"]) == 0
    np.testing.assert_allclose(read_recordings(tmp_path / "out").subjects[0].z[0], Z[::-1], rtol=1e-12)
