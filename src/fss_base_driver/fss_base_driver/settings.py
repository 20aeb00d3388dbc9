"""The parameters of the base's nodes."""

from dataclasses import dataclass

from fss_arm_model.settings import (
    NOT_NEGATIVE,
    POSITIVE,
    SettingError,
    Settings,
    one_of,
    setting,
)

SYSTEMS = ("vicon", "vrpn", "optitrack", "qualisys", "mock")


@dataclass(frozen=True)
class MocapSettings(Settings):
    """The parameters of a MocapNode."""

    system: str = setting(
        "",
        "motion-capture system to receive from; empty: none, only relays",
        check=one_of("", *SYSTEMS),
    )
    host: str = setting("", "address of the computer that runs the motion-capture system")
    options: tuple[str, ...] = setting(
        (), "further options of the motion-capture library, each OPTION=VALUE"
    )
    relays: tuple[str, ...] = setting(
        (),
        "topics of other receivers to pass on, each SUBJECT=TOPIC, or TOPIC if messages hold names",
    )
    relay_scale: float = setting(
        1.0, "length of one unit of the relayed topics; 0.001 for millimetres", unit="m",
        check=POSITIVE,
    )  # fmt: skip
    subjects: tuple[str, ...] = setting(
        (), "names of subjects to pass on, each NAME or NAME=SUBJECT/SEGMENT; empty: all"
    )
    prefix: str = setting("vicon", "first part of the topics PREFIX/SUBJECT/SEGMENT")
    frame_id: str = setting("world", "frame that the poses are in")
    latency: float = setting(
        0.0, "delay from exposure to arrival, taken off the time of arrival", unit="s",
        check=NOT_NEGATIVE,
    )  # fmt: skip
    max_speed: float = setting(
        1.0, "speed above which a subject has jumped", unit="m/s", check=POSITIVE
    )
    max_turn: float = setting(
        3.0, "rate of turn above which a subject has jumped", unit="rad/s", check=POSITIVE
    )
    settle_time: float = setting(
        1.0, "time of plausible motion after which a subject that jumped is believed again",
        unit="s", check=POSITIVE,
    )  # fmt: skip
    timeout: float = setting(
        1.0, "silence after which the system or a subject is reported", unit="s", check=POSITIVE
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.system and not self.relays:
            raise SettingError(
                f"system is '' and relays is empty, expected one of {', '.join(SYSTEMS)}, or topics"
            )
        if self.system not in ("", "mock") and not self.host:
            raise SettingError(f"host is '', expected the address of the {self.system} computer")
        for option in self.options:
            if "=" not in option:
                raise SettingError(f"options holds {option!r}, expected OPTION=VALUE")

    def topics(self) -> dict[str, str]:
        """By name of a subject, what follows the prefix in its topic; empty: any subject."""
        pairs = (subject.partition("=")[::2] for subject in self.subjects)
        return {name: place or f"{name}/{name}" for name, place in pairs}
