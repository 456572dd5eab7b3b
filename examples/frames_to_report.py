"""From camera frames to a report in five lines.

Run it with the folder of a recording: `python frames_to_report.py data/raw/mine`. The report is gap/gap.html.
"""

import sys

import tossid

dataset = tossid.ingest(sys.argv[1])
model = tossid.train(dataset, model="cn")
print(tossid.evaluate(model, dataset.split("test")))
gap = tossid.diagnose(dataset, simulator="nominal")
gap.save("gap")
