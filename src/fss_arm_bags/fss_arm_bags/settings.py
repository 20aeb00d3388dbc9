"""The parameters of the nodes."""

from dataclasses import dataclass

from fss_arm_model.settings import NOT_NEGATIVE, SettingError, Settings, setting

SHARED = (
    *("/clock", "/tf", "/tf_static", "/diagnostics", "/rosout", "/parameter_events"),
    *("/vicon", "/sim"),
)  # topics that all vehicles of a laboratory share


@dataclass(frozen=True)
class RecordSettings(Settings):
    """The parameters of a RecordNode."""

    output: str = setting("", "folder of the bags; the next of bag_0, bag_1, ... is written")
    topics: tuple[str, ...] = setting(
        (), "record only these topics, in any namespace; empty: all of `namespace` and `shared`"
    )
    namespace: str = setting(
        "/", "namespace whose topics are recorded; /: all topics", within="/{namespace}"
    )
    shared: tuple[str, ...] = setting(
        SHARED, "topics outside the namespace to record too, with all topics below them"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.output:
            raise SettingError("output is empty, expected the folder of the bags: -p output:=DIR")


@dataclass(frozen=True)
class ReplaySettings(Settings):
    """The parameters of a ReplayNode."""

    rate: float = setting(
        1.0,
        "speed relative to the recording; 0: as fast as subscribers receive",
        check=NOT_NEGATIVE,
    )
    start: float = setting(
        0.0, "time after the first message at which to start", unit="s", check=NOT_NEGATIVE
    )
    loop: bool = setting(False, "repeat from the start")
    topics: tuple[str, ...] = setting(
        (),
        "play only these, under their own names; empty: measurements under their own names, "
        "results under recorded/",
    )
    clock: bool = setting(False, "publish /clock from the times of receipt")
    hold: bool = setting(
        False, "keep running after the end, so that late subscribers get latched topics"
    )
    wait_for: tuple[str, ...] = setting(
        (), "topics that need a subscriber before the start; repeat a topic for several subscribers"
    )
    deadline: float = setting(
        20.0, "timeout waiting for the subscribers of wait_for", unit="s", check=NOT_NEGATIVE
    )
    discovery: float = setting(
        3.0, "time to wait for subscribers if wait_for is empty", unit="s", check=NOT_NEGATIVE
    )
