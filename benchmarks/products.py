# SPDX-License-Identifier: MIT
"""Cost of derivatives: products compared with their functions, folders with derivatives with folders without.

    python -m benchmarks.products

Prints the table of docs/derivatives.md (hybrid joint stiffness of the iiwa 14, contenders/products.c), then lines and
the compiler's processor time of whole folders, as ``stiffgen generate`` builds them, the least of some builds.
"""

import resource
import shutil
import tempfile
from pathlib import Path

import stiffgen
from benchmarks.tools import AVX2, HERE, NATIVE, PLAIN, URDF, pinned, run

ROUNDS = 301
BUILDS = 5


def ratios(folder: Path, scratch: Path) -> None:
    """Print a line per compiler and flags."""
    print("| product over function | single | batch | ns: function, product, batches of them |\n|---|---|---|---|")
    for compiler in filter(shutil.which, ("gcc", "clang")):
        for flags in (NATIVE, AVX2, PLAIN):
            sources = [f'-DSOURCE="{folder / folder.name}.c"', f'-DBATCHES="{folder / folder.name}_batch.c"']
            built = [str(HERE / "contenders" / "products.c"), *sources, f"-I{folder}", "-o", str(scratch / "products")]
            run([compiler, *flags.split(), "-w", *built, "-lm"])
            ns = [float(text) for text in run(pinned([str(scratch / "products"), str(ROUNDS)])).split()]
            row = f"{ns[1] / ns[0]:.2f} | {ns[3] / ns[2]:.2f} | {', '.join(f'{each:.0f}' for each in ns)}"
            print(f"| {compiler} {flags} | {row} |")


def compiled(output: Path, *, derivatives: bool) -> tuple[Path, float]:
    """Build a folder; return it and the processor time of its compiler [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    folder = stiffgen.generate(URDF, output=output, derivatives=derivatives)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return folder, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as name:
        lines, seconds = [0, 0], [float("inf")] * 2
        for _ in range(BUILDS):
            for which in (0, 1):  # by turns: others on a shared machine slow down what they please
                folder, taken = compiled(Path(name) / str(which), derivatives=bool(which))
                seconds[which] = min(seconds[which], taken)
                texts = [path for path in folder.iterdir() if path.suffix not in (".so", ".pyd") and path.is_file()]
                lines[which] = sum(len(path.read_text().splitlines()) for path in texts)
        ratios(folder, Path(name))
        print(f"lines {lines[0]}, with derivatives {lines[1]}: {lines[1] / lines[0]:.2f}")
        print(f"compiler {seconds[0]:.1f} s, with derivatives {seconds[1]:.1f} s: {seconds[1] / seconds[0]:.2f}")


if __name__ == "__main__":
    main()
