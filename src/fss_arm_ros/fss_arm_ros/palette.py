"""Colors of pages, figures and drawings; each has one meaning.

The colors of the drawings follow Okabe and Ito (2008): they differ for color-blind users, too. Red,
amber and green are for states, and a text always names the state.
"""

# Drawings and curves.
STATIC = "#666666"  # table and its scale; arm on a fixed base
MEASURED = "#0068a8"  # base and arm as measured
PREDICTED = "#e69f00"
BAND = "#f6d58c"  # band of one sigma about the prediction
TIP = "#0fa57b"  # end effector
TARGET = "#cc79a7"  # target and its keep-out circle
THRUST = "#70c8f8"  # thrusters that fire
DIFFERENCE = "#5b1a3c"  # measured minus predicted
AXES = "#303030", "#a5780a"  # x and y axis of a frame
#: By link or joint.
LINKS = (
    *("#82552d", "#eb96be", "#7d8719", "#5f3c96", "#46a08c", "#c86e5a"),
    *("#9696c8", "#3c5a3c", "#beb46e", "#6e8296", "#aa3c6e", "#cdcd32"),
)

# States: good (healthy, passed), attention (warning), danger (error, failed).
POSITIVE, ATTENTION, DANGER = "#1b7a3d", "#8a6100", "#b3261e"  # as text, and below white text
POSITIVE_FILL, ATTENTION_FILL = "#e0f2e5", "#ffe8b0"  # below dark text

# Pages.
TEXT, MUTED, RULE, GRID = "#222222", "#666666", "#bbbbbb", "#e4e4e4"

VARIABLES = {
    "static": STATIC,
    "measured": MEASURED,
    "predicted": PREDICTED,
    "band": BAND,
    "tip": TIP,
    "target": TARGET,
    "thrust": THRUST,
    "good": POSITIVE,
    "attention": ATTENTION,
    "danger": DANGER,
    "good-fill": POSITIVE_FILL,
    "attention-fill": ATTENTION_FILL,
    "text": TEXT,
    "muted": MUTED,
    "rule": RULE,
    "grid": GRID,
}


def css() -> str:
    """Return the colors of pages as CSS variables, such as `var(--measured)`."""
    lines = "".join(f"--{name}: {color}; " for name, color in VARIABLES.items())
    return f":root {{ {lines}}}\n"


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue of a color, 0 to 255."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)
