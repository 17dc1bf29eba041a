"""A controller that prints what it would do: a thermostat whose heating power follows the served model.

    controller.py URL SYSTEM [--token TOKEN] [--memory FILE] [--polls N] [--wait SECONDS]

It needs httpx. `parameters.py` is the part to copy.
"""

import argparse

from parameters import Parameters

# What is used before anything was ever validated: the nominal values of `tite`.
BASELINE = {"model": "tite", "parameters": {"alpha_e": 0.2, "beta_e": 5.0, "alpha_a": 0.2, "c_P_heater": 0.5, "c_solar": 0.5}}
# The room is kept this much warmer, in K, while the parameters are not to be trusted.
CAUTION_K = 0.5
WANTED = 21.0


def holding_power(values, room, outdoors):
    """The power in the unit of the heating channel that keeps the room where it is, by TiTe, in the dark.

    In a steady state the envelope passes on what it gets: alpha_e/beta_e (T_r - T_e) = alpha_a (T_e - T_out).
    """
    inward = values["alpha_e"] / values["beta_e"]
    envelope = (inward * room + values["alpha_a"] * outdoors) / (inward + values["alpha_a"])
    return max(0.0, values["alpha_e"] * (room - envelope) / values["c_P_heater"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("url")
    parser.add_argument("system")
    parser.add_argument("--token")
    parser.add_argument("--memory")
    parser.add_argument("--polls", type=int, default=0, help="how many; by default it never ends")
    parser.add_argument("--wait", type=int, default=30, help="seconds that the service may wait for news")
    parser.add_argument("--outdoors", type=float, default=5.0, help="degC")
    arguments = parser.parse_args()
    parameters = Parameters(arguments.url, arguments.system, BASELINE, arguments.token, arguments.memory)
    turn = 0
    while arguments.polls == 0 or turn < arguments.polls:
        turn += 1
        what = parameters.poll(arguments.wait)
        wanted = WANTED if parameters.trusted() else WANTED + CAUTION_K
        power = holding_power(parameters.values, wanted, arguments.outdoors)
        because = f" ({parameters.problem})" if parameters.problem else ""
        print(f"{what}{because}: revision {parameters.revision}, {parameters.status}: {wanted} degC, power {power:.3f}", flush=True)


if __name__ == "__main__":
    main()
