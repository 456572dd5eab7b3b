"""A dataset read with h5py alone, as a program without tossid would: one group a toss, one array a quantity.

The schema is in docs/adr/0003-dataset-schema.md.
"""

import h5py
import numpy as np

import tossid

tossid.synthesize("cube", tosses=6, engine="lcp", out="made")

with h5py.File("made/tosses.h5") as file:
    print(f"{file.attrs['n_tosses']} tosses of '{file['object'].attrs['name']}' at {file.attrs['rate_hz']:g} Hz")
    for name, toss in file["tosses"].items():
        t, v = toss["t"][()], toss["v"][()]  # [s]; [m/s] in the world, [rad/s] in the body
        speed = np.linalg.norm(v[:, :3], axis=1)
        print(f"{name} ({toss.attrs['split']}): {t[-1]:.2f} s, up to {speed.max():.1f} m/s")
