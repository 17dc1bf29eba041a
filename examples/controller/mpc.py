"""Model predictive control by the matrices that the service makes of the model in force. No line of it is physics.

    controller = Controller("http://127.0.0.1:8080", "room/4", power="P_heater", largest=4.0)
    power = controller.decide(time, {"T_out": [...]}, price, lowest)

It needs casadi and httpx.
"""

import casadi as ca
import httpx

# What a kelvin below the lowest temperature costs in a step, in the unit of the price, and what a change of power does.
DISCOMFORT, RESTLESS = 10.0, 1e-3


class Controller:
    """Decides about the power of one room, step by step. `power` is its channel, `largest` the most in its unit."""

    def __init__(self, url, system, power, largest, token=None, minutes=15):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._client = httpx.Client(base_url=url, headers=headers, timeout=10)
        self._path, self._power, self._largest, self._minutes = f"/systems/{system}/linearisation", power, largest, minutes
        self._plan, self.follows, self.problem = [0.0], None, None

    def decide(self, time, inputs, price, lowest):
        """The power of the next step. `time` has the instants ahead and `inputs` a value for each by channel; `price`
        and `lowest`, a room temperature, are a value per step. Without an answer the last plan goes on."""
        steps = len(time) - 1
        self.goes_on()
        self._plan = (self._plan + [self._plan[-1]] * (steps + 1))[: steps + 1]
        asked = {"horizon": f"PT{steps * self._minutes}M", "step": f"PT{self._minutes}M"}
        asked["inputs"] = {"time": time, "values": inputs | {self._power: self._plan}}
        try:
            answer = self._client.post(self._path, json=asked).raise_for_status().json()
        except httpx.HTTPError as error:
            self.problem = str(error)
            return self._plan[0]
        self.problem, self.follows = None, (answer["model"], answer["revision"])
        self._plan = self._solved(answer, price, lowest)
        return self._plan[0]

    def goes_on(self):
        """The power of the next step by the last plan."""
        self._plan = self._plan[1:] or self._plan
        return self._plan[0]

    def _solved(self, model, price, lowest):
        opti, steps = ca.Opti(), model["steps"]
        place = [held["channel"] for held in model["held"]].index(self._power)
        plan, cold = opti.variable(len(steps)), opti.variable(len(steps))
        x, cost = ca.DM(steps[0]["states"]), 0
        for k, step in enumerate(steps):
            a, b, e, e_next, c, d, f, now, then = (
                ca.DM(step[name]) for name in ("a", "b", "e", "e_next", "c", "d_held", "d_moving", "moving", "moving_next")
            )
            held = ca.vertcat(*[plan[k] if i == place else value for i, value in enumerate(step["held"])])
            room = (c @ x + d @ held + f @ now + ca.DM(step["output_offset"]))[0]
            x = a @ x + b @ held + e @ now + e_next @ then + ca.DM(step["offset"])
            if k > 0:  # The room is as it is now, whatever is decided.
                opti.subject_to(cold[k] >= lowest[k] - room)
            cost += price[k] * plan[k] / self._largest + DISCOMFORT * cold[k] + RESTLESS * (plan[k] - plan[max(k - 1, 0)]) ** 2
        opti.subject_to([opti.bounded(0, plan, self._largest), cold >= 0])
        opti.minimize(cost)
        opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
        return ca.DM(opti.solve().value(plan)).full().ravel().tolist()
