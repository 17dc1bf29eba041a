//! The built-in models and effects, and what the compiler makes of them.

use super::*;
use expr::Node;

fn bindings(channels: &[&str], neighbours: &[&str]) -> Bindings {
    let mut bindings = Bindings {
        channels: Some(channels.iter().map(|name| (*name).to_owned()).collect()),
        ..Bindings::default()
    };
    if !neighbours.is_empty() {
        bindings.sets.insert("neighbours".into(), neighbours.iter().map(|name| (*name).to_owned()).collect());
    }
    bindings
}

fn build(id: &str, channels: &[&str], neighbours: &[&str]) -> Result<Model, Vec<crate::fault::Fault>> {
    compile(&Catalogue::builtin().unwrap().compose(&id.parse().unwrap())?, &bindings(channels, neighbours))
}

const WEATHER: [&str; 4] = ["T_out", "T_forward", "sun_altitude", "cloud_cover"];

#[test]
fn every_built_in_model_and_effect_compiles() {
    let catalogue = Catalogue::builtin().unwrap();
    for document in catalogue.models() {
        let model =
            compile(&catalogue.compose(&document.id().parse().unwrap()).unwrap(), &Bindings::default());
        assert!(model.is_ok(), "{}: {model:?}", document.id());
    }
    for effect in catalogue.effects() {
        let name = |argument: &str| format!("{}:{argument}", effect.id);
        let names: Vec<String> = match &effect.argument {
            None => vec![effect.id.clone()],
            Some(_) if effect.choices.is_empty() => vec![name("x_test")],
            Some(_) => effect.choices.keys().map(|choice| name(choice)).collect(),
        };
        for name in names {
            let models = ["room3", "asm1_h"].map(|base| {
                compile(
                    &catalogue.compose(&format!("{base}+{name}").parse().unwrap()).unwrap(),
                    &Bindings::default(),
                )
            });
            assert!(models.iter().any(Result::is_ok), "{name}: {models:?}");
            let texts = [&effect.explain, &effect.signature, &effect.measure];
            assert!(texts.iter().all(|text| !text.is_empty()), "{name} does not explain itself");
        }
    }
}

#[test]
fn room3_with_four_neighbours_has_the_fifteen_parameters_of_the_thesis() {
    let mut channels = WEATHER.to_vec();
    channels.extend(["T_room_1", "T_room_2", "T_room_5", "T_room_6"]);
    let model = build("room3", &channels, &["1", "2", "5", "6"]).unwrap();
    assert_eq!(model.parameters().len(), 15);
    let names: Vec<&str> = model.inputs().iter().map(|input| input.channel.as_str()).collect();
    assert_eq!(
        names,
        ["T_forward", "T_out", "sun_altitude", "cloud_cover", "T_room_1", "T_room_2", "T_room_5", "T_room_6"]
    );
}

/// Equations 7.1 to 7.5, written out by hand.
#[test]
fn room3_means_the_equations_of_the_thesis() {
    let model =
        build("room3", &["T_out", "T_forward", "sun_altitude", "cloud_cover", "T_room_7"], &["7"]).unwrap();
    let value = |name: &str| match name {
        "alpha_h" => 0.4,
        "alpha_e" => 0.7,
        "alpha_w" => 1.1,
        "alpha_a" => 0.05,
        "alpha_s" => 0.9,
        "alpha_n[7]" => 0.3,
        "beta_h" => 4.0,
        "beta_he" => 9.0,
        "k" => 2.5,
        "T_set" => 21.5,
        "T_out" => -3.0,
        "T_forward" => 35.0,
        "sun_altitude" => 20.0,
        "cloud_cover" => 0.4,
        "T_n[7]" => 20.5,
        _ => f64::NAN,
    };
    let (t_r, t_h, t_e) = (21.0, 26.0, 18.0);
    let leaf = |node: Node| match node {
        Node::State(i) => [t_r, t_h, t_e][usize::from(i)],
        Node::Param(i) => value(&model.parameters()[usize::from(i)].name),
        Node::Input(i, _) => value(&model.inputs()[usize::from(i)].name),
        _ => f64::NAN,
    };
    let ours = model.graph().evaluate(model.rhs(), leaf);
    let flow = 1.0 / (1.0 + (2.5f64 * (t_r - 21.5)).exp());
    let sun = 20f64.to_radians().sin() * (1.0 - 0.75 * 0.4f64.powf(3.4));
    let by_hand = [
        0.4 * (t_h - t_r) + 0.7 * (t_e - t_r) + 0.9 * sun,
        0.4 / 4.0 * (t_r - t_h) + 1.1 * flow * (35.0 - t_h),
        0.7 / 9.0 * (t_r - t_e) + 0.05 * (-3.0 - t_e) + 0.3 * (20.5 - t_e),
    ];
    for (ours, by_hand) in ours.iter().zip(by_hand) {
        assert!((ours - by_hand).abs() < 1e-13, "{ours} {by_hand}");
    }
}

#[test]
fn a_measured_valve_replaces_the_thermostat_and_its_parameters() {
    let model = build("room3", &["T_out", "T_forward", "irradiance", "valve"], &[]).unwrap();
    assert!(model.parameters().iter().all(|parameter| parameter.name != "k" && parameter.name != "T_set"));
    assert_eq!(model.inputs().iter().filter(|input| input.hold == InputHold::ZeroOrder).count(), 1);
    assert!(model.dropped().is_empty());
}

#[test]
fn a_part_without_its_channel_is_dropped_and_said_so() {
    let model = build("tite", &["T_out"], &[]).unwrap();
    assert_eq!(model.dropped().len(), 2, "{:?}", model.dropped());
    assert_eq!(model.parameters().len(), 4);
    let faults = build("rc2+wind_infiltration", &["T_out"], &[]).unwrap_err();
    assert_eq!(faults[0].code, "missing-channel");
}

#[test]
fn a_model_with_an_effect_is_another_model() {
    let base = build("room3", &WEATHER, &[]).unwrap();
    let mut channels = WEATHER.to_vec();
    channels.push("wind_speed");
    let windy = build("room3+wind_infiltration", &channels, &[]).unwrap();
    assert_ne!(base.hash(), windy.hash());
    assert_eq!(windy.parameters().len(), base.parameters().len() + 1);
    assert_eq!(windy.effects(), ["wind_infiltration"]);
    assert_eq!(
        build("room3", &channels, &[]).unwrap().hash(),
        base.hash(),
        "an unused channel is no part of the model"
    );
}

#[test]
fn nested_sums_cannot_explode() {
    let nested = (0..40).fold("1[K/h]".to_owned(), |inner, n| format!("sum(i{n} in rooms: {inner})"));
    let text = format!(
        r#"
        id = "big"
        title = "big"
        sets = ["rooms"]
        states.x = {{ unit = "degC", initial = "y" }}
        equations.x = "{nested}"
        outputs.y = {{ expr = "x", unit = "degC", noise_sd = 0.05 }}
    "#
    );
    let mut catalogue = Catalogue::default();
    catalogue.add_model(super::document::ModelDocument::from_toml(&text).unwrap());
    let rooms = [("rooms".to_owned(), vec!["1".to_owned(), "2".to_owned(), "3".to_owned()])].into();
    let faults = compile(
        &catalogue.compose(&"big".parse().unwrap()).unwrap(),
        &Bindings { sets: rooms, channels: None },
    )
    .unwrap_err();
    assert!(faults.iter().any(|fault| fault.code == "too-large"), "{faults:?}");
}

/// A model of one state, whose rate is this expression.
fn with_rate(rate: &str) -> Result<Model, Vec<crate::fault::Fault>> {
    let text = format!(
        r#"
        id = "one"
        title = "one state"
        states.x = {{ unit = "degC", initial = "y" }}
        inputs.u = {{ unit = "degC" }}
        inputs.P = {{ unit = "kW", hold = "zero_order" }}
        parameters.a = {{ unit = "1/h", lower = 1e-3, upper = 10, scale = "log", nominal = 1 }}
        parameters.tau = {{ unit = "h", lower = 0, upper = 6, scale = "linear", nominal = 1 }}
        parameters.lead = {{ unit = "h", lower = -1, upper = 6, scale = "linear", nominal = 1 }}
        parameters.age = {{ unit = "h", lower = 0, upper = 1000, scale = "linear", nominal = 1 }}
        equations.x = "{rate}"
        outputs.y = {{ expr = "x", unit = "degC", noise_sd = 0.05 }}
    "#
    );
    let mut catalogue = Catalogue::default();
    catalogue.add_model(super::document::ModelDocument::from_toml(&text).unwrap());
    compile(&catalogue.compose(&"one".parse().unwrap()).unwrap(), &Bindings::default())
}

#[test]
fn a_delay_says_how_much_of_the_past_it_needs() {
    let longest =
        |hours: &str| with_rate(&format!("a*(delay(u, {hours}) - x)")).map(|model| model.longest_delay(0));
    assert_eq!(longest("tau"), Ok(6.0));
    assert_eq!(longest("2[h]"), Ok(2.0));
    assert_eq!(longest("min(2*tau, 4[h])"), Ok(4.0));
    assert_eq!(longest("min(3[h], 1/a)"), Ok(3.0));
    assert_eq!(with_rate("a*(u - x)").unwrap().longest_delay(0), 0.0);
    for (hours, code) in [
        ("2*tau", "delay"),
        ("lead", "delay"),
        ("-1[h]", "delay"),
        ("min(max(0[h], lead), 2[h]) + 0[h]*x/1[K]", "delay"),
        ("a", "unit"),
        ("500[h]", "limit"),
        ("age", "limit"),
        ("tua", "unknown-name"),
        ("tau, 6", "arguments"),
    ] {
        let faults = longest(hours).unwrap_err();
        assert_eq!(faults[0].code, code, "{hours}: {faults:?}");
    }
    let faults = with_rate("a*(delay(x, tau) - x)").unwrap_err();
    assert_eq!((faults.len(), faults[0].suggestion.as_deref()), (1, Some("the inputs are u, P")));
    assert!(faults[0].detail.starts_with("line 1, column 10: only an input"), "{faults:?}");
    assert_eq!(with_rate("a*(delay(u + u, tau) - x)").unwrap_err()[0].code, "delay");
}

#[test]
fn a_quantity_is_counted_in_another_unit() {
    let model = with_rate("convert(convert(a, 1[1/d]), 1[1/h])*(u - x) + convert(48[K/d], 1[K/h])").unwrap();
    let leaf = |node: Node| if matches!(node, Node::State(_)) { 2.0 } else { 3.0 };
    assert!((model.graph().evaluate(model.rhs(), leaf)[0] - 5.0).abs() < 1e-14);
    for wrong in [
        "convert(a, 2[1/h])*(u - x)",
        "convert(a, 1[K])*(u - x)",
        "convert(a, tau)*(u - x)",
        "convert(x, 1[K])*a",
    ] {
        assert_eq!(with_rate(wrong).unwrap_err()[0].code, "unit", "{wrong}");
    }
}

#[test]
fn a_clock_is_no_straight_line_between_samples() {
    let clock = r#"
        id = "clock"
        title = "a clock that is read as a line"
        states.x = { unit = "degC", initial = "y" }
        inputs.hour = { unit = "h", channel = "hour_of_day" }
        parameters.c = { unit = "K/h", lower = 0, upper = 1, scale = "linear", nominal = 0.5 }
        equations.x = "c * (hour < 12[h])"
        outputs.y = { expr = "x", unit = "degC", noise_sd = 0.05 }
    "#;
    let mut catalogue = Catalogue::default();
    catalogue.add_model(super::document::ModelDocument::from_toml(clock).unwrap());
    let faults =
        compile(&catalogue.compose(&"clock".parse().unwrap()).unwrap(), &Bindings::default()).unwrap_err();
    assert_eq!(
        (faults.len(), faults[0].code.as_str(), faults[0].pointer.as_str()),
        (1, "hold", "/inputs/hour/hold")
    );
}

#[test]
fn all_faults_are_reported_at_once() {
    let text = r#"
        id = "bad"
        title = "bad"
        [states]
        T_r = { unit = "degC", initial = "T_room" }
        T_e = { unit = "degC", initial = "nothing" }
        [inputs]
        T_out = { unit = "furlong" }
        P = { unit = "kW" }
        [parameters]
        alpha_e = { unit = "1/h", lower = 2, upper = 1, scale = "log", nominal = 0.2 }
        [define]
        a = "b + 1"
        b = "a"
        [equations]
        T_r = "alpa_e*(T_e - T_r) + P"
        T_e = "alpha_e*(T_r - T_e"
        [outputs]
        T_room = { expr = "T_r + a*0[K] + T_r^2.5*0[K]", unit = "degC", noise_sd = 0.05 }
    "#;
    let mut catalogue = Catalogue::default();
    catalogue.add_model(super::document::ModelDocument::from_toml(text).unwrap());
    let faults =
        compile(&catalogue.compose(&"bad".parse().unwrap()).unwrap(), &Bindings::default()).unwrap_err();
    let codes: Vec<&str> = faults.iter().map(|fault| fault.code.as_str()).collect();
    for code in ["unit", "bounds", "cycle", "unknown-name", "syntax", "negative-base"] {
        assert!(codes.contains(&code), "{code} is missing in {faults:#?}");
    }
    let slip = faults.iter().find(|fault| fault.pointer == "/equations/T_r").unwrap();
    assert_eq!(slip.suggestion.as_deref(), Some("did you mean `alpha_e`?"));
}

#[test]
fn a_quantity_names_a_parameter_and_changes_no_hash() {
    let catalogue = Catalogue::builtin().unwrap();
    let mut composition = catalogue.compose(&"rc2+solar_gain".parse().unwrap()).unwrap();
    let all = bindings(&["T_out", "irradiance"], &[]);
    let named = compile(&composition, &all).unwrap();
    composition.spec.parameters.values_mut().for_each(|parameter| parameter.quantity.clear());
    let plain = compile(&composition, &all).unwrap();
    assert_eq!(named.parameters()[0].title, "heat exchange, envelope to room air");
    assert_eq!(plain.parameters()[0].title, "envelope to room air");
    assert_eq!(named.hash(), plain.hash());
}
