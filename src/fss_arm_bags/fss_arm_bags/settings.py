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
        (), "names of the topics to record, wherever they are; none: all of the namespace"
    )
    namespace: str = setting(
        "/", "namespace whose topics are recorded; /: all there are", within="/{namespace}"
    )
    shared: tuple[str, ...] = setting(
        SHARED, "topics, with those below them, that are recorded beside those of the namespace"
    )
    split_size: float = setting(
        2000.0, "size at which the next bag is begun; 0: never", unit="MB", check=NOT_NEGATIVE
    )
    split_time: float = setting(
        3600.0, "duration after which the next bag is begun; 0: never", unit="s", check=NOT_NEGATIVE
    )
    reserve: float = setting(
        1000.0, "free space on the disk below which it warns", unit="MB", check=NOT_NEGATIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.output:
            raise SettingError("output is empty, expected the folder of the bags: -p output:=DIR")


@dataclass(frozen=True)
class ReplaySettings(Settings):
    """The parameters of a ReplayNode."""

    rate: float = setting(
        1.0, "multiple of the recorded pace; 0: as fast as subscribers take it", check=NOT_NEGATIVE
    )
    start: float = setting(
        0.0, "where to begin, after the first message", unit="s", check=NOT_NEGATIVE
    )
    loop: bool = setting(False, "begin again at the end")
    topics: tuple[str, ...] = setting(
        (), "play these alone, in place; none: measurements in place, results under recorded/"
    )
    clock: bool = setting(False, "publish /clock from the times of receipt")
    hold: bool = setting(False, "stay up after the end, so that latched topics stay, too")
    wait_for: tuple[str, ...] = setting(
        (), "topics that must have a subscriber before the start; one named n times: n of them"
    )
    deadline: float = setting(
        20.0, "how long to wait for those topics' subscribers", unit="s", check=NOT_NEGATIVE
    )
    discovery: float = setting(
        3.0, "time for subscribers to show up if wait_for is empty", unit="s", check=NOT_NEGATIVE
    )
