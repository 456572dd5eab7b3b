"""A diagnosis of a model that is trained in the same script: what the model cannot say, the diagnosis names.

The tosses fall with 7 m/s². The model learns contact alone, with 9.81 m/s² given; the diagnosis finds gravity.
"""

import sys

import tossid
from tossid.physics.effects import LIBRARY

dataset = tossid.synthesize(
    "cube", engine="lcp", tosses=16, effects={"gravity": {"g_ms2": 7.0}}, noise__position=5e-4, noise__rotation=5e-3
)
model = tossid.train(dataset, model="cn", epochs=20, horizons=())

quick = "--quick" in sys.argv  # considers two effects instead of the whole library
without = tuple(effect.name for effect in LIBRARY if quick and effect.name not in ("gravity", "friction"))
gap = tossid.diagnose(dataset, simulator=model, without=without, repeats=0 if quick else 4)
print(gap)
gap.save("gap")
