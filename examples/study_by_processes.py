"""A study by two processes: which models repair a wrong gravity? Interrupted, the same call goes on where it was.

The number of epochs may be given: `python study_by_processes.py 40`.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import tossid


def main() -> None:
    """Make tosses, run the study, print its table."""
    epochs = int(sys.argv[1]) if len(sys.argv) > 1 else 30
    tossid.synthesize("cube", engine="lcp", tosses=10, noise__position=5e-4, noise__velocity=0.02).save("tosses.h5")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        study = tossid.study(
            "tosses.h5",
            key="gravity",
            values=[0.0, 9.81],
            models=["cn", "cnrp"],
            epochs=epochs,
            horizons=(),
            folder="studies/gravity",  # each cell, as soon as it is done
            submit=pool.submit,
            each_cell=lambda cell, outcome: print(f"done: {cell.model}, {cell.value:g} m/s²"),
        )
    study.save("studies/gravity")
    print(study)


if __name__ == "__main__":  # the processes import this file
    main()
