"""Residuals of a simulation: whiteness, correlation with the inputs."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import free_run
from tustinnet.models.contract import Model
from tustinnet.shown import Brief
from tustinnet.simulate.starts import start_named

_USUAL_LAGS = 50  # samples
LAG_CONFIDENCE = 0.99  # share of the lags of independent residuals that is inside
_QUANTILE = NormalDist().inv_cdf((1 + LAG_CONFIDENCE) / 2)


@dataclass(frozen=True, repr=False)
class ResidualReport(Brief):
    """Residuals of one coordinate over several free runs.

    Attributes:
        coordinate: its name.
        rms: root mean square [rad or m].
        mean: mean [rad or m].
        autocorrelation: at lags 0..L, (L + 1,).
        white_bound: what independent residuals stay within at 99 % of the lags.
        outside: share of the lags 1..L beyond it.
        cross: correlation with each input at lags -L..L (the residual later where positive),
            (n_u, 2 L + 1); empty where no input changes.
        cross_bound: what residuals that owe nothing to each input stay within at 99 % of the lags,
            (n_u,).
        cross_outside: share of the lags 0..L beyond it, per input, (n_u,).
    """

    coordinate: str
    rms: float
    mean: float
    autocorrelation: Float[np.ndarray, " lags"]
    white_bound: float
    outside: float
    cross: Float[np.ndarray, "n_u both"]
    cross_bound: Float[np.ndarray, " n_u"]
    cross_outside: Float[np.ndarray, " n_u"]

    @property
    def is_white(self) -> bool:
        """Whether no more lags are outside than independent residuals would have."""
        return self.outside <= 1 - LAG_CONFIDENCE + 0.01

    @property
    def sentence(self) -> str:
        """The verdict in a sentence."""
        first = float(self.autocorrelation[1]) if len(self.autocorrelation) > 1 else 0.0
        sentence = (
            "white: nothing predictable is left"
            if self.is_white
            else f"not white ({100 * self.outside:.0f} % of the lags outside, {first:.2f} from one "
            "sample to the next): the model lacks something"
        )
        if len(self.cross_outside) and float(self.cross_outside.max()) > 1 - LAG_CONFIDENCE + 0.01:
            sentence += (
                f"; {100 * self.cross_outside.max():.0f} % of the lags correlate with an input: "
                "its effect is not all modelled"
            )
        return sentence

    def as_plain(self) -> dict[str, Any]:
        """The residuals as plain values, for JSON."""
        content = {**asdict(self), "white": self.is_white}
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in content.items()}


def residual_reports(
    model: Model,
    experiments: Sequence[Experiment],
    start: str,
    lags: int | None = None,
    *,
    horizon: float | None = None,
    runs: Sequence[Float[np.ndarray, "_ n_x"]] | None = None,
) -> list[ResidualReport]:
    """Examines the free-run residuals (measured minus simulated) of records.

    Correlations are pooled over the records; residuals are not centred, so an offset counts.

    Args:
        model: the model.
        experiments: records.
        start: where the free runs start, the name of a start.
        lags: largest lag in samples; by default 50, or as many as the shortest record has.
        horizon: how long a free run lasts at most [s], see `free_run`; correlations reach across
            the segments of a record.
        runs: the free runs, if they were computed before.

    Raises:
        InputError: lags that the shortest record does not have, a free run that diverges; see also
            `free_run`.

    References:
        Söderström, Stoica (1989), System Identification, section 11.2.
        Ljung (1999), System Identification: Theory for the User, section 16.6.
    """
    begin, at = start_named(start).first, model.channels.position
    most = min(map(len, experiments)) - begin - 1
    lags = min(_USUAL_LAGS, most) if lags is None else lags
    if not 1 <= lags <= most:
        raise InputError("lags", f"{lags} samples", f"1 to {most}")
    runs = runs or free_run(model, experiments, start, horizon=horizon)
    residuals = [e.q[begin:] - x[begin:, at] for e, x in zip(experiments, runs, strict=True)]
    for e, r in zip(experiments, residuals, strict=True):
        if not np.isfinite(r).all():
            raise InputError(
                e.name, "a free run that diverges", "a model that simulates it", "leave it out"
            )
    forced = [i for i, e in enumerate(experiments) if e.forced]
    inputs = [(u := experiments[i].u[begin:]) - u.mean(axis=0) for i in forced]
    reports = []
    for j in range(model.channels.n_q):
        series = [r[:, j] for r in residuals]
        pooled, auto = np.concatenate(series), _correlation(series, series, lags)
        bound = _QUANTILE / np.sqrt(len(pooled))
        driven = [series[i] for i in forced]
        cross, cross_bounds = [], []
        for k in range(model.channels.n_u if forced else 0):
            driving = [u[:, k] for u in inputs]
            cross.append(_correlation(driven, driving, lags))
            # coloured signals correlate by chance over more lags than white ones do
            of_residual = _correlation(driven, driven, lags)
            of_input = _correlation(driving, driving, lags)
            chance = max(float(of_residual @ of_input), 1.0)
            cross_bounds.append(_QUANTILE * np.sqrt(chance / sum(map(len, driven))))
        outside = [np.mean(np.abs(c[lags:]) > b) for c, b in zip(cross, cross_bounds, strict=True)]
        reports.append(
            ResidualReport(
                coordinate=model.coordinates[j].name,
                rms=float(np.sqrt(np.mean(pooled**2))),
                mean=float(pooled.mean()),
                autocorrelation=auto[lags:],
                white_bound=float(bound),
                outside=float(np.mean(np.abs(auto[lags + 1 :]) > bound)),
                cross=np.array(cross).reshape(len(cross), 2 * lags + 1),
                cross_bound=np.array(cross_bounds),
                cross_outside=np.array(outside),
            )
        )
    return reports


def _correlation(
    later: Sequence[np.ndarray], earlier: Sequence[np.ndarray], lags: int
) -> Float[np.ndarray, " both"]:
    """Normalised correlation at lags -L..L, pooled over records, not centred."""
    total = np.zeros(2 * lags + 1)
    for a, b in zip(later, earlier, strict=True):
        size = len(a) + len(b) + lags  # so long that nothing comes round from the other end
        spectrum = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
        total += np.fft.irfft(spectrum, size)[np.arange(-lags, lags + 1)]
    power = np.sqrt(sum(a @ a for a in later) * sum(b @ b for b in earlier))
    return total / power if power > 0 else total
