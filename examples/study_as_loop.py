"""A study written as a loop: how the error falls with the number of training tosses, with a wrong and a right gravity.

The numbers of epochs and of tosses may be given: `python study_as_loop.py 40 2 8 32`.
"""

import sys

import tossid

epochs, *counts = [int(word) for word in sys.argv[1:]] or [30, 2, 4, 8]
dataset = tossid.synthesize(
    "cube", engine="lcp", tosses=2 * max(counts) + 4, noise__position=5e-4, noise__velocity=0.02
)
test = dataset.split("test")

print("tosses  gravity given  rotation error")
for tosses in counts:
    for gravity in (9.81, 0.0):
        model = tossid.train(dataset, model="cnrp", tosses=tosses, epochs=epochs, gravity=gravity)
        error = tossid.evaluate(model, test).metrics["rotation_error_deg"]
        print(f"{tosses:6d} {gravity:8.2f} m/s² {error['mean']:10.1f} deg")
