#!/usr/bin/env bash
# The main job, end to end, on a simulated test bed: simulator, drivers,
# calibration, bag, and back.
# usage: demo.sh [--help] [--speed 5] [--seed 1] [--out DIR]
exec "$(dirname "${BASH_SOURCE[0]}")/rehearse.sh" demo "$@"
