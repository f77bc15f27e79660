"""Time and memory of `import` for raw signals: 71 persons with three files of a megabyte each.

Run from the repository's root: python benchmarks/intake.py [-o OUT] [--persons 71]

The same files are read in the same run by numpy and scipy alone (load, and H1 by `scipy.signal.csd` with the same
segments), which is the least that anybody does with them. The peak of the memory is that of a process of its own, for
all files and for a tenth of them. Prints a line for each, and writes intake.json beside this file.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

REPETITIONS, SAMPLES, RATE_HZ, SEGMENT_S = 3, 131_072, 10_240.0, 0.4
"""Two channels of 131 072 samples in single precision are a megabyte."""
LIMIT_S, FLAT = 60.0, 1.25
"""What is asked for: seconds for all files, and the peak memory of all over that of a tenth."""


def write_signals(folder: Path, persons: int) -> None:
    """Force noise on a mass, damper and spring that differ between persons, and its acceleration."""
    folder.mkdir(parents=True, exist_ok=True)
    for person in range(persons):
        rng = np.random.default_rng(person)
        mass, damper, stiffness = np.array([2e-3, 2.0, 2e3]) * np.exp(0.2 * rng.normal(size=3))
        for repetition in range(1, REPETITIONS + 1):
            force = rng.normal(size=SAMPLES)
            s = 2j * np.pi * np.fft.rfftfreq(SAMPLES, 1 / RATE_HZ)
            acceleration = np.fft.irfft(np.fft.rfft(force) * s**2 / (s**2 * mass + s * damper + stiffness), SAMPLES)
            acceleration += 1e-3 * acceleration.std() * rng.normal(size=SAMPLES)
            file = folder / f"P{person:03d}_{repetition}.npz"
            np.savez(file, force=force.astype(np.float32), acceleration=acceleration.astype(np.float32), fs=RATE_HZ)


def arguments(folder: Path, out: Path, files: list[Path]) -> list[str]:
    sources = [str(folder)] if files == sorted(folder.glob("*.npz")) else list(map(str, files))
    channels = ["--force", "force[N]", "--motion", "acceleration[m/s^2]", "--excitation", "noise"]
    names = ["--subject-from-name", r"(?P<subject>[^_]+)_(?P<repetition>\d+)"]
    band = ["--band", "10", "2000", "--segment", str(SEGMENT_S)]
    return ["import", *sources, *channels, *names, *band, "-o", str(out), "--overwrite"]


def imported(words: list[str]) -> tuple[float, float]:
    """Seconds of the command, and the peak of its memory in megabytes."""
    program = (
        "import resource, sys; from bayes_impedance.commands.cli import main; status = main(sys.argv[1:]); "
        "print('peak', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024); sys.exit(status)"
    )
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", program, *words], check=True, capture_output=True, text=True)
    return time.perf_counter() - start, float(done.stdout.rsplit("peak", 1)[1])


def read_by_scipy(files: list[Path]) -> float:
    """Seconds to load the files and estimate H1 with the same segments."""
    from scipy.signal import csd, welch

    start, length = time.perf_counter(), int(SEGMENT_S * RATE_HZ)
    for file in files:
        content = np.load(file)
        force, acceleration = content["force"], content["acceleration"]
        _, cross = csd(acceleration, force, RATE_HZ, nperseg=length)
        _, own = welch(acceleration, RATE_HZ, nperseg=length)
        assert np.all(np.isfinite(cross[1:] / own[1:]))
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/intake"))
    parser.add_argument("--persons", type=int, default=71)
    options = parser.parse_args()
    folder = options.out / f"signals_{options.persons}"
    write_signals(folder, options.persons)
    files = sorted(folder.glob("*.npz"))
    some = files[: max(1, options.persons // 10) * REPETITIONS]
    peer = read_by_scipy(files)
    seconds, peak = imported(arguments(folder, options.out / "all", files))
    few_seconds, few_peak = imported(arguments(folder, options.out / "some", some))
    found = {
        "files": len(files),
        "megabytes": sum(file.stat().st_size for file in files) / 1e6,
        "seconds": seconds,
        "seconds_numpy_scipy": peer,
        "ratio": seconds / peer,
        "peak_mb": peak,
        "files_of_a_tenth": len(some),
        "seconds_of_a_tenth": few_seconds,
        "peak_mb_of_a_tenth": few_peak,
        "peak_ratio": peak / few_peak,
        "own_peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "within": seconds < LIMIT_S and peak < FLAT * few_peak,
    }
    results = Path(__file__).resolve().parent / "intake.json"
    results.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    for name, value in found.items():
        print(f"{name:22} {value if isinstance(value, bool | int) else f'{value:.3g}'}")


if __name__ == "__main__":
    main()
