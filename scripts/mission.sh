#!/usr/bin/env bash
# Rehearses a capture: go to a tumbling target by thrusters, grip it with the
# arm, stop it.
# usage: mission.sh [--help] [--seed 1] [--speed 1] [--assumed KG] [--spin RAD/S]
#        [--closing-time S] [--force N] [--torque NM] [--cancel-momentum]
#        [--out DIR]
exec "$(dirname "${BASH_SOURCE[0]}")/rehearse.sh" capture "$@"
