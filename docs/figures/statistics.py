"""How an interval over episodes shrinks, and what an interquartile mean leaves out."""

import matplotlib.pyplot as plt
import numpy as np

from ppt_rl.evaluation import interval
from ppt_rl.evaluation.resampling import iqm_interval

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
counts = np.array([16, 32, 64, 128, 256, 512, 1024])
for share, color in ((0.95, "tab:red"), (0.5, "tab:blue")):
    rows = [np.arange(n) < round(share * n) for n in counts]
    low, high = np.array([interval(row.astype(float), is_rate=True) for row in rows]).T
    left.fill_between(counts, low, high, color=color, alpha=0.3, label=f"success {share}")
left.set(xscale="log", xlabel="episodes", ylabel="95 % interval (Wilson)", xticks=counts, xticklabels=counts)
left.minorticks_off()
left.legend(fontsize=8)
seeds = np.array([[0.93], [0.95], [0.96], [0.94], [0.40]])  # (runs, groups)
right.plot(seeds[:, 0], np.zeros(5), "o", label="five seeds, one failed")
right.plot(seeds.mean(), 0.3, "s", color="grey", label="mean")
found = iqm_interval(seeds)
middle, (low, high) = found["iqm"], found["iqm_ci95"]
right.errorbar(
    middle, 0.6, xerr=[[middle - low], [high - middle]], fmt="D", color="tab:red", label="interquartile mean, 95 %"
)
right.set(xlabel="success", yticks=[], ylim=(-0.3, 1.6))
right.legend(fontsize=8)
