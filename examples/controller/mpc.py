"""Model predictive control with do-mpc whose parameters are the served ones, at every step.

The model is TiTe. Its parameters enter as time-varying ones, so that a new revision takes effect at the next step and
nothing is built again. It needs do-mpc and httpx.
"""

import do_mpc

# The parameters of TiTe that steer; the temperature at the start of a record is none of them.
NAMES = ("alpha_e", "beta_e", "alpha_a", "c_P_heater", "c_solar")
# What is told ahead of time: outdoor temperature in degC, irradiance in W/m2, price per unit of energy, lowest room
# temperature in degC.
FORECAST = ("T_out", "irradiance", "price", "lowest")
HORIZON = 24
# What a kelvin-hour below the lowest temperature costs, in the unit of the price.
DISCOMFORT = 10.0
# The lowest temperature is raised by this much, in K, while the parameters are not to be trusted.
CAUTION_K = 0.5


class Controller:
    """Decides about the heating power of one room, hour by hour.

    `parameters` has `values` and `trusted()`, as `parameters.Parameters` has. `largest` is the largest power in the
    unit of the heating channel.
    """

    def __init__(self, parameters, largest):
        self._parameters = parameters
        self._forecast = None
        model = do_mpc.model.Model("continuous")
        room, envelope = (model.set_variable("_x", name) for name in ("T_r", "T_e"))
        power = model.set_variable("_u", "power")
        known = {name: model.set_variable("_tvp", name) for name in NAMES + FORECAST}
        sun = known["irradiance"] / 1000
        through = known["alpha_e"] * (envelope - room)
        model.set_rhs("T_r", through + known["c_P_heater"] * power + known["c_solar"] * sun)
        model.set_rhs("T_e", -through / known["beta_e"] + known["alpha_a"] * (known["T_out"] - envelope))
        model.setup()
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon = HORIZON
        mpc.settings.t_step = 1.0
        mpc.settings.store_full_solution = False
        mpc.settings.supress_ipopt_output()
        mpc.set_objective(mterm=0 * room, lterm=known["price"] * power / largest)
        mpc.set_rterm(power=1e-4 / largest**2)
        mpc.bounds["lower", "_u", "power"] = 0.0
        mpc.bounds["upper", "_u", "power"] = largest
        mpc.scaling["_u", "power"] = largest
        mpc.set_nl_cons("cold", known["lowest"] - room, ub=0.0, soft_constraint=True, penalty_term_cons=DISCOMFORT)
        self._told = mpc.get_tvp_template()
        mpc.set_tvp_fun(self._ahead)
        mpc.setup()
        self._mpc = mpc
        self._started = False

    def decide(self, states, forecast):
        """The power of the next hour, from the states `T_r` and `T_e` and a forecast by name, a value per hour."""
        self._forecast = forecast
        x0 = [[states["T_r"]], [states["T_e"]]]
        if not self._started:
            self._mpc.x0 = _column(x0)
            self._mpc.set_initial_guess()
            self._started = True
        return float(self._mpc.make_step(_column(x0))[0, 0])

    def _ahead(self, _now):
        """What do-mpc asks for before every step: forecast and parameters over the horizon."""
        if self._forecast is None:
            # While it is built, do-mpc asks for the form of the answer alone.
            return self._told
        caution = 0.0 if self._parameters.trusted() else CAUTION_K
        for hour in range(HORIZON + 1):
            for name in NAMES:
                self._told["_tvp", hour, name] = self._parameters.values[name]
            for name in FORECAST:
                series = self._forecast[name]
                self._told["_tvp", hour, name] = series[min(hour, len(series) - 1)] + (caution if name == "lowest" else 0.0)
        return self._told


def _column(rows):
    import numpy

    return numpy.array(rows, dtype=float)
