"""What links are reached by: a pseudo-terminal as by RS-232."""

import os
import tty

import pytest

from fss_arm_driver.protocol import StreamDecoder, pack
from fss_sim.link.pty import LinkTerminal

FRAME = bytes(range(72))


@pytest.fixture
def terminal(tmp_path):
    made = LinkTerminal(str(tmp_path / "link_1"))
    yield made
    made.close()


@pytest.fixture
def driver(terminal):
    far = os.open(terminal.place, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(far)
    yield far
    os.close(far)


def test_frames_pass_both_ways_once_somebody_is_known(terminal, driver):
    os.write(driver, b"noise" + pack(FRAME) + pack(FRAME)[:40])
    got = []
    while not got:  # the line takes its time
        got = terminal.receive()
    ((data, peer),) = got
    assert data == FRAME
    terminal.send(b"to nobody" * 8, None)
    terminal.send(FRAME[::-1], peer)
    decoder, frames = StreamDecoder(), []
    while not frames:
        frames = decoder.feed(os.read(driver, 1000))
    assert frames == [FRAME[::-1]]


def test_a_line_that_nobody_reads_blocks_nothing(terminal):
    for _ in range(1000):
        terminal.send(FRAME, terminal)


def test_its_path_goes_with_it_and_is_not_taken_from_others(tmp_path):
    path = tmp_path / "link_1"
    first = LinkTerminal(str(path))
    second = LinkTerminal(str(path))
    first.close()
    assert path.is_symlink()
    second.close()
    assert not path.is_symlink()
    path.write_text("mine")
    with pytest.raises(OSError, match="link_1 cannot be made"):
        LinkTerminal(str(path))
