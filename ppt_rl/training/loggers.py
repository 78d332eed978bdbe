"""Where the scalars of a run go besides its CSV files: TensorBoard, Weights & Biases, MLflow, by torchrl's loggers."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from torchrl.record.loggers import TensorboardLogger

from ppt_rl.functional.argument_checks import shown
from ppt_rl.training.extras import require_package

__all__ = ["LOGGERS", "Sink", "open_sinks", "require_loggers"]

#: Names of the loggers.
LOGGERS = ("csv", "tensorboard", "wandb", "mlflow")
#: Project of Weights & Biases, and experiment of MLflow.
_PROJECT = "ppt_rl"


class Sink(Protocol):
    """Takes the scalars of a run, from its first step on."""

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        """Log scalars.

        Args:
            scalars: values by name.
            step: control steps so far.
        """
        ...

    def flush(self) -> None:
        """Write out what is still buffered."""
        ...

    def close(self) -> None:
        """Write out what is still buffered, and close."""
        ...


def require_loggers(names: Sequence[str]) -> None:
    """Raise unless these are loggers whose packages are installed.

    Args:
        names: names of loggers.

    Raises:
        ValueError: if one is unknown, or is named twice.
        MissingPackage: if the package of one is not installed.
    """
    if not isinstance(names, tuple | list) or not set(names) <= set(LOGGERS) or len(set(names)) < len(names):
        raise ValueError(f"logger is {shown(names)}; expected some of {list(LOGGERS)}, each once at most.")
    for name in ("wandb", "mlflow"):
        if name in names:
            require_package(name, name, f"--logger {name}")


def open_sinks(names: Sequence[str], run_dir: Path, options: Mapping[str, Any]) -> list[Sink]:
    """Open what these loggers write to, empty: what an earlier process logged is cleared.

    Args:
        names: names of loggers; ``csv`` has no part in it.
        run_dir: directory of the run.
        options: options of the run, which Weights & Biases and MLflow show beside its scalars.

    Returns:
        The sinks.

    Raises:
        ValueError: if a logger is unknown.
        MissingPackage: if the package of one is not installed.
    """
    require_loggers(names)
    kinds: dict[str, Callable[..., Sink]] = {"tensorboard": _TensorBoard, "wandb": _WeightsAndBiases, "mlflow": _MLflow}
    return [kinds[name](run_dir, options) for name in names if name in kinds]


class _TensorBoard:
    """Event files in ``logs/tensorboard``."""

    def __init__(self, run_dir: Path, options: Mapping[str, Any]) -> None:
        logs = run_dir / "logs"
        for path in (logs / "tensorboard").glob("events.out.tfevents.*"):
            path.unlink()
        self._logger = TensorboardLogger(exp_name="tensorboard", log_dir=str(logs))

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        for name, value in scalars.items():
            self._logger.log_scalar(name, value, step=step)

    def flush(self) -> None:
        self._logger.experiment.flush()

    def close(self) -> None:
        self._logger.experiment.close()


class _WeightsAndBiases:
    """An offline run in ``logs/wandb``, which ``wandb sync`` sends to a server."""

    def __init__(self, run_dir: Path, options: Mapping[str, Any]) -> None:
        import wandb
        from torchrl.record.loggers.wandb import WandbLogger

        logs = run_dir / "logs"
        shutil.rmtree(logs / "wandb", ignore_errors=True)
        self._logger = WandbLogger(
            exp_name=run_dir.name, offline=True, save_dir=str(logs), project=_PROJECT, log_env_packages=False,
            mode="offline", reinit="finish_previous", settings=wandb.Settings(silent=True, console="off"),
        )  # fmt: skip
        self._logger.log_hparams(dict(options))

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        self._logger.experiment.log(dict(scalars), step=step)

    def flush(self) -> None:
        """Its own process writes at once."""

    def close(self) -> None:
        self._logger.experiment.finish()


class _MLflow:
    """A run of the experiment ``ppt_rl`` in the database ``logs/mlflow.db``; earlier runs in it are deleted."""

    def __init__(self, run_dir: Path, options: Mapping[str, Any]) -> None:
        import mlflow
        from torchrl.record.loggers.mlflow import MLFlowLogger

        logs = (run_dir / "logs").resolve()
        logs.mkdir(parents=True, exist_ok=True)
        uri = f"sqlite:///{logs / 'mlflow.db'}"
        client = mlflow.MlflowClient(tracking_uri=uri)
        experiment = client.get_experiment_by_name(_PROJECT)
        for run in [] if experiment is None else client.search_runs([experiment.experiment_id]):
            client.delete_run(run.info.run_id)
        mlflow.end_run()  # of a run that was not closed in this process
        self._logger = MLFlowLogger(exp_name=_PROJECT, tracking_uri=uri, artifact_location=(logs / "mlflow").as_uri())
        self._mlflow = mlflow
        mlflow.set_tag("mlflow.runName", run_dir.name)
        mlflow.log_params({name: str(value)[:500] for name, value in options.items()})

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        self._logger.log_metrics(dict(scalars), step=step)

    def flush(self) -> None:
        """Every value is in the database at once."""

    def close(self) -> None:
        self._mlflow.end_run()
