"""State of a calibration node that is kept across a restart: its data, and flags of streams."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from fss_arm_calib.segments.streams import Streams
from fss_arm_model.files import ContentError
from fss_arm_ros.state_file import StateError, from_json, read, write

D = TypeVar("D")


@dataclass(frozen=True)
class Flags:
    """State of the streams that is kept across a restart."""

    unknown: tuple[str, ...] = ()  # joints received that the arm does not have
    set_back: Mapping[str, float] = field(default_factory=dict)  # steps back of stamps [s]
    rejected: Mapping[str, int] = field(default_factory=dict)  # samples, by stream and reason

    @classmethod
    def of(cls, streams: Streams) -> "Flags":
        """Return the flags of streams."""
        back = {name: by for name, by in streams.set_back.items() if by > 0.0}
        return cls(tuple(streams.unknown), back, dict(streams.rejected))

    def and_then(self, streams: Streams) -> Streams:
        """Return the state of the streams combined with these earlier flags."""
        a, b = self, streams
        back = {k: max(a.set_back.get(k, 0.0), x) for k, x in {**a.set_back, **b.set_back}.items()}
        rejected = {**b.rejected, **Counter(a.rejected) + Counter(b.rejected)}
        unknown = tuple(dict.fromkeys([*a.unknown, *b.unknown]))
        return replace(streams, unknown=unknown, set_back=back, rejected=rejected)


def save(path: str | Path, kind: str, joints: int, data: Sequence[Any], flags: Flags) -> None:
    """Save the data of a calibration and the flags of its streams."""
    saved = [asdict(one) for one in data]
    whole = {"kind": kind, "joints": joints, "data": saved, "flags": asdict(flags)}
    write(path, whole, indent=None)  # otherwise mostly spaces


def restore(path: str | Path, kind: str, joints: int, datum: type[D]) -> tuple[list[D], Flags]:
    """Restore data, of class `datum`, and flags of a calibration; both are empty without a file.

    Raises:
        StateError: the file is not of this kind and number of joints, or has other contents.
    """
    saved = read(path, None) if path else None
    if saved is None:
        return [], Flags()
    try:
        if not isinstance(saved, dict) or set(saved) != {"kind", "joints", "data", "flags"}:
            raise ContentError("it", saved, "an object of kind, joints, data and flags")
        for name, value in (("kind", kind), ("joints", joints)):
            if saved[name] != value:
                raise ContentError(name, saved[name], repr(value))
        data = from_json(tuple[datum, ...], saved["data"], "data")  # type: ignore[valid-type]
        return list(data), from_json(Flags, saved["flags"], "flags")
    except (RecursionError, ValueError) as error:
        raise StateError(f"{path}: {error}; move the file away to start without its data") from None
