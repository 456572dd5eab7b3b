"""An object of one's own: a brick, tossed on a slippery floor, written with its file and its tosses.

An object in a file is as short: `tossid.objects.load_object("brick.xml", friction=0.3)`.
"""

from pathlib import Path

import numpy as np

import tossid

brick = tossid.objects.box("brick", edges=(0.2, 0.1, 0.06), mass=0.5, friction=0.3)
dataset = tossid.synthesize(brick, tosses=8, engine="lcp", effects={"friction": {"mu": 0.1}})
dataset.save("brick.h5")
Path("brick.xml").write_text(tossid.objects.to_mjcf(brick))

for toss in dataset.tosses:
    slid = np.linalg.norm(toss.q[-1, :2] - toss.q[0, :2])
    print(f"toss {toss.name}: {toss.t[-1]:.2f} s, {slid:.2f} m from release to rest")
