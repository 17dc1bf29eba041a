//! What a document says about how it is stepped, and from where: the stepper's demands and the warm-up.

use super::spec::{InputHold, ModelSpec, Stepper, WarmUpInputs};
use super::{Delay, Held, Input, WarmUp};
use crate::fault::{Fault, nearest};

/// Longest warm-up in hours: a year.
pub(super) const MAX_HOURS: f64 = 8784.0;

/// The warm-up of a model with these inputs, and every fault of it and of its stepper.
pub(super) fn warm_up(spec: &ModelSpec, inputs: &[Input], delays: &[Delay]) -> (Option<WarmUp>, Vec<Fault>) {
    let mut faults = Vec::new();
    if spec.stepper == Stepper::Rkc {
        // Between two samples the equations must not depend on time: each candidate steps at times of its
        // own.
        for input in inputs.iter().filter(|input| input.hold == InputHold::Linear) {
            let detail = format!(
                "the stepper rkc needs inputs that are held between samples, `{}` is not",
                input.name
            );
            faults.push(
                Fault::new(format!("/inputs/{}/hold", input.name), "hold", detail)
                    .suggest("write hold = \"zero_order\""),
            );
        }
        for delay in delays {
            let name = inputs.get(delay.input).map_or("", |input| input.name.as_str());
            let detail = format!("the stepper rkc knows no delays, the equations delay `{name}`");
            faults.push(
                Fault::new(format!("/inputs/{name}"), "delay", detail).suggest("leave the stepper out"),
            );
        }
    }
    let Some(asked) = &spec.warm_up else { return (None, faults) };
    if spec.stepper != Stepper::Rkc {
        faults.push(
            Fault::new("/warm_up", "stepper", "a warm-up needs the stepper rkc")
                .suggest("write stepper = \"rkc\""),
        );
    }
    if !(asked.hours > 0.0 && asked.hours <= MAX_HOURS) {
        faults.push(Fault::new(
            "/warm_up/hours",
            "limit",
            format!("a warm-up takes more than 0 and at most {MAX_HOURS} hours"),
        ));
    }
    let given = match &asked.inputs {
        WarmUpInputs::Values(given) => given,
        WarmUpInputs::Record(_) => {
            return (Some(WarmUp { hours: asked.hours, inputs: vec![Held::Mean; inputs.len()] }), faults);
        }
    };
    for (name, value) in given {
        let pointer = format!("/warm_up/inputs/{name}");
        if !spec.inputs.contains_key(name) && !inputs.iter().any(|input| input.name == *name) {
            let fault = Fault::new(&pointer, "unknown-name", format!("the model has no input `{name}`"));
            faults.push(match nearest(name, inputs.iter().map(|input| input.name.as_str())) {
                Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                None => fault,
            });
        }
        if !value.is_finite() {
            faults.push(Fault::new(pointer, "not-finite", format!("{value} is not a finite number")));
        }
    }
    for input in inputs
        .iter()
        .filter(|input| spec.inputs.contains_key(&input.name) && !given.contains_key(&input.name))
    {
        let detail = format!("the warm-up gives no value of the input `{}`", input.name);
        faults.push(Fault::new("/warm_up/inputs", "missing-input", detail));
    }
    let values = inputs
        .iter()
        .map(|input| given.get(&input.name).map_or(Held::First, |value| Held::Value(*value)))
        .collect();
    (Some(WarmUp { hours: asked.hours, inputs: values }), faults)
}

#[cfg(test)]
mod tests {
    use crate::model::document::ModelDocument;
    use crate::model::{Bindings, Catalogue, Model, compile};

    fn build(hold: &str, extra: &str) -> Result<Model, Vec<crate::fault::Fault>> {
        let text = format!(
            r#"
            id = "tank"
            title = "a tank"
            {extra}
            [states]
            c = {{ unit = "g/m3", initial = "2" }}
            [inputs]
            u = {{ unit = "g/m3", hold = "{hold}" }}
            [parameters]
            a = {{ unit = "1/h", lower = 0.1, upper = 1000, scale = "log", nominal = 1 }}
            [equations]
            c = "a*(u - c)"
            [outputs]
            y = {{ expr = "c", unit = "g/m3", noise_sd = 0.1 }}
            "#
        );
        let mut catalogue = Catalogue::default();
        catalogue.add_model(ModelDocument::from_toml(&text).map_err(|fault| vec![fault])?);
        compile(&catalogue.compose(&"tank".parse().unwrap())?, &Bindings::default())
    }

    fn codes(hold: &str, extra: &str) -> Vec<(String, String)> {
        build(hold, extra)
            .unwrap_err()
            .into_iter()
            .map(|fault| (fault.pointer, fault.code.to_string()))
            .collect()
    }

    fn pair(pointer: &str, code: &str) -> (String, String) {
        (pointer.to_owned(), code.to_owned())
    }

    #[test]
    fn every_fault_of_a_warm_up_is_said_at_once() {
        let found = codes("linear", "stepper = \"rkc\"\nwarm_up = { hours = 1e9, inputs = { v = nan } }");
        let wanted = [
            pair("/inputs/u/hold", "hold"),
            pair("/warm_up/hours", "limit"),
            pair("/warm_up/inputs/v", "unknown-name"),
            pair("/warm_up/inputs/v", "not-finite"),
            pair("/warm_up/inputs", "missing-input"),
        ];
        assert_eq!(found, wanted);
        assert_eq!(
            codes("zero_order", "warm_up = { hours = 1, inputs = { u = 2 } }"),
            [pair("/warm_up", "stepper")]
        );
        assert_eq!(
            codes("zero_order", "warm_up = { hours = 1, inputs = \"mean\" }"),
            [pair("/warm_up", "stepper")]
        );
        assert_eq!(
            build("zero_order", "stepper = \"rkc\"\nwarm_up = { hours = 1, inputs = \"first\" }")
                .unwrap_err()[0]
                .code,
            "invalid-document"
        );
        assert_eq!(build("zero_order", "stepper = \"rk4\"").unwrap_err()[0].code, "invalid-document");
        assert_eq!(
            codes("zero_order", "stepper = \"rkc\"\nwarm_up = { hours = nan, inputs = { u = 2 } }"),
            [pair("/warm_up/hours", "limit")]
        );
    }

    #[test]
    fn stepper_and_warm_up_belong_to_the_hash() {
        let hash = |extra: &str| build("zero_order", extra).unwrap().hash().to_owned();
        let plain = hash("");
        assert_eq!(plain, hash("stepper = \"ros2\""), "the default is no choice");
        let all = [
            plain,
            hash("stepper = \"rkc\""),
            hash("stepper = \"rkc\"\nwarm_up = { hours = 1, inputs = { u = 2 } }"),
            hash("stepper = \"rkc\"\nwarm_up = { hours = 1, inputs = { u = 3 } }"),
            hash("stepper = \"rkc\"\nwarm_up = { hours = 1, inputs = \"mean\" }"),
        ];
        assert!((0..5).all(|i| (0..i).all(|j| all[i] != all[j])));
    }
}
