//! What the controller makes of served parameters: the catalogue's model, linear from sample to sample, and a
//! filter that follows its states.

use super::mpc::{Output, Step};
use lampyris::cli::{Failure, faults};
use lampyris_core::model::expr::{Node, NodeId};
use lampyris_core::model::{Bindings, Catalogue, InputHold, Model, ModelId, compile};
use lampyris_core::twin::heated::{HeatedRoom, SAMPLE_HOURS};
use nalgebra::{DMatrix, DVector, RowDVector};
use serde_json::Value;

/// The channel of the heat, in kW.
const HEAT: &str = "P_heater";
/// What the controller has a forecast of, beside the heat, on which it decides itself.
const FORECAST: [&str; 5] = ["T_out", "irradiance", "wind_speed", "hour_of_day", "weekday"];
/// Process noise of every state in K per square root of an hour, and the deviation of the sensor with its
/// display in K.
const PROCESS: f64 = 0.1;
const SENSOR: f64 = 0.06;
/// Variance of what no sensor measures before anything is known, in K2.
const HIDDEN: f64 = 9.0;
/// Where the states are until the filter knows better, in degC.
const INDOORS: f64 = 21.0;

/// A model with its parameters.
#[derive(Debug, Clone)]
pub struct Grey {
    model: Model,
    theta: Vec<f64>,
}

impl Grey {
    /// The model of a body of `/params`.
    ///
    /// # Errors
    /// Where the controller has no forecast of an input of the model, or the model looks back into one.
    pub fn new(catalogue: &Catalogue, params: &Value) -> Result<Self, Failure> {
        let id: ModelId = params["model"]
            .as_str()
            .unwrap_or_default()
            .parse()
            .map_err(|error| Failure::Error(format!("{error}")))?;
        let channels = FORECAST.into_iter().chain([HEAT]).map(str::to_owned).collect();
        let composition = catalogue.compose(&id).map_err(|found| faults(&found))?;
        let model = compile(&composition, &Bindings { channels: Some(channels), ..Bindings::default() })
            .map_err(|found| faults(&found))?;
        if !model.delays().is_empty() {
            return Err(Failure::Error(format!("{id} looks back into its inputs")));
        }
        let value = |name: &str| params["parameters"][name].as_f64().unwrap_or(INDOORS);
        // Only a temperature at the start has no nominal value, and the filter does not use it.
        let theta = model.parameters().iter().map(|parameter| value(&parameter.name)).collect();
        Ok(Self { model, theta })
    }

    pub fn states(&self) -> usize {
        self.model.states().len()
    }

    /// The step from a sample to the next, linear about these states.
    pub fn step(&self, room: &HeatedRoom, sample: usize, about: &DVector<f64>) -> Step {
        let inputs = |heat: f64| self.inputs(room, sample, heat);
        let (idle, one) = (inputs(0.0), inputs(1.0));
        let (rates, heated) =
            (self.at(self.model.rhs(), about, &idle), self.at(self.model.rhs(), about, &one));
        let n = self.states();
        let nodes: Vec<NodeId> = self.model.jacobian().iter().flatten().copied().collect();
        let matrix = DMatrix::from_row_slice(n, n, &self.at(&nodes, about, &idle));
        let rates = DVector::from_vec(rates);
        let heat = DVector::from_vec(heated) - &rates;
        let constant = rates - &matrix * about;
        Step::over_a_sample(&matrix, &heat, &constant)
    }

    /// How the room follows from the states.
    pub fn output(&self, about: &DVector<f64>) -> Output {
        let Some(output) = self.model.outputs().first() else {
            return Output { row: RowDVector::zeros(self.states()), offset: 0.0 };
        };
        let none = vec![0.0; self.model.inputs().len()];
        let row = RowDVector::from_vec(self.at(&output.gradient, about, &none));
        let value = self.at(&[output.node], about, &none).first().copied().unwrap_or_default();
        Output { offset: value - (&row * about)[0], row }
    }

    fn at(&self, nodes: &[NodeId], states: &DVector<f64>, inputs: &[f64]) -> Vec<f64> {
        self.model.graph().evaluate(nodes, |leaf| match leaf {
            Node::State(i) => states[usize::from(i)],
            Node::Param(i) => self.theta[usize::from(i)],
            Node::Input(i, _) => inputs[usize::from(i)],
            // Slopes and steps belong to a simulation.
            _ => 0.0,
        })
    }

    /// Every input over an interval: held ones as they are at its start, others in its middle.
    fn inputs(&self, room: &HeatedRoom, sample: usize, heat: f64) -> Vec<f64> {
        let (now, next) = (room.weather(sample), room.weather(sample + 1));
        let (hour, weekday) = room.clock(sample);
        let input = |input: &lampyris_core::model::Input| {
            let part = if input.hold == InputHold::Linear { 0.5 } else { 0.0 };
            let between = |from: f64, to: f64| from + part * (to - from);
            match input.channel.as_str() {
                HEAT => heat,
                "T_out" => between(now.out, next.out),
                "irradiance" => between(now.irradiance, next.irradiance),
                "wind_speed" => between(now.wind, next.wind),
                "hour_of_day" => hour,
                _ => weekday,
            }
        };
        self.model.inputs().iter().map(input).collect()
    }
}

/// A Kalman filter on the states of a model.
#[derive(Debug, Clone)]
pub struct Observer {
    pub x: DVector<f64>,
    p: DMatrix<f64>,
}

impl Observer {
    /// Knows nothing yet but that it is indoors.
    pub fn new(states: usize) -> Self {
        Self { x: DVector::from_element(states, INDOORS), p: DMatrix::identity(states, states) * HIDDEN }
    }

    pub fn predict(&mut self, step: &Step, heat: f64) {
        self.x = step.advance(&self.x, heat);
        let noise = DMatrix::identity(self.x.len(), self.x.len()) * (PROCESS * PROCESS * SAMPLE_HOURS);
        self.p = &step.matrix * &self.p * step.matrix.transpose() + noise;
    }

    pub fn update(&mut self, output: &Output, measured: f64) {
        let spread = &self.p * output.row.transpose();
        let variance = (&output.row * &spread)[0] + SENSOR * SENSOR;
        let gain = &spread / variance;
        self.x += &gain * (measured - output.of(&self.x));
        self.p -= &gain * spread.transpose();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn served(model: &str, more: Value) -> Value {
        let mut parameters = json!({
            "alpha_e": 0.5, "beta_e": 6.0, "alpha_a": 0.03, "c_P_heater": 0.4, "c_solar": 0.7, "T_e0": null
        });
        parameters.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        json!({"model": model, "parameters": parameters})
    }

    /// The equations of TiTe and of the wind, written out by hand and stepped finely.
    #[test]
    fn a_step_of_the_served_model_is_that_of_its_equations() {
        let catalogue = Catalogue::builtin().unwrap();
        let room = HeatedRoom::new(4, 3, 3, 3).unwrap();
        let grey = Grey::new(&catalogue, &served("tite+wind_infiltration", json!({"c_wind": 0.01}))).unwrap();
        let start = DVector::from_vec(vec![20.0, 18.0]);
        for (sample, heat) in [(4, 0.0), (24, 3.0)] {
            let (now, next) = (room.weather(sample), room.weather(sample + 1));
            let middle = |from: f64, to: f64| 0.5 * (from + to);
            let (out, sun, wind) = (
                middle(now.out, next.out),
                middle(now.irradiance, next.irradiance) / 1000.0,
                middle(now.wind, next.wind),
            );
            let (mut r, mut e) = (20.0, 18.0);
            let fine = 100_000;
            for _ in 0..fine {
                let dr = 0.5 * (e - r) + 0.4 * heat + 0.7 * sun + 0.01 * wind * (out - r);
                let de = 0.5 / 6.0 * (r - e) + 0.03 * (out - e);
                (r, e) = (r + dr * SAMPLE_HOURS / f64::from(fine), e + de * SAMPLE_HOURS / f64::from(fine));
            }
            let ours = grey.step(&room, sample, &start).advance(&start, heat);
            assert!((ours[0] - r).abs() < 1e-5 && (ours[1] - e).abs() < 1e-5, "{ours} beside {r} {e}");
        }
        let output = grey.output(&start);
        assert_eq!((output.of(&start), output.row[1]), (20.0, 0.0));
    }

    #[test]
    fn a_filter_finds_the_state_that_no_sensor_measures() {
        let room = HeatedRoom::new(4, 6, 6, 6).unwrap();
        let grey = Grey::new(&Catalogue::builtin().unwrap(), &served("tite", json!({}))).unwrap();
        let mut truth = DVector::from_vec(vec![19.0, 14.0]);
        let mut observer = Observer::new(2);
        for sample in 0..4 * 48 {
            let output = grey.output(&truth);
            observer.update(&output, output.of(&truth));
            let step = grey.step(&room, sample, &truth);
            truth = step.advance(&truth, 2.0);
            observer.predict(&step, 2.0);
        }
        assert!((&observer.x - &truth).amax() < 0.05, "{} beside {truth}", observer.x);
    }

    #[test]
    fn a_model_whose_inputs_nobody_forecasts_is_refused() {
        let catalogue = Catalogue::builtin().unwrap();
        for model in ["tite+window_opening", "tite+metered_gain:P_x", "ghost"] {
            assert!(Grey::new(&catalogue, &served(model, json!({}))).is_err(), "{model}");
        }
    }
}
