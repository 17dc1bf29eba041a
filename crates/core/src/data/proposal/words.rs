//! What columns are called, in a few languages.

/// Channels with the parts of names that mean them; the first that is met counts, so that `Aussenfeuchte` is
/// no temperature.
const MEANINGS: [(&str, &[&str]); 20] = [
    ("setpoint", &["soll", "setpoint", "set point", "consigne", "setpunt"]),
    ("RH_out", &["aussenfeuchte", "außenfeuchte", "outdoor humidity", "rh out"]),
    ("RH_room", &["feuchte", "humidity", "rh ", "hygro", "vocht"]),
    ("CO2", &["co2"]),
    ("window_open", &["fenster", "window", "raam", "fenetre"]),
    ("wind_direction", &["windrichtung", "wind dir", "windrichting"]),
    ("wind_speed", &["wind", "vent vitesse"]),
    ("cloud_cover", &["wolken", "bewölk", "bewoelk", "cloud", "bewolking"]),
    (
        "irradiance",
        &["strahlung", "irradiance", "ghi", "solar", "globalstr", "sonne", "zonnestr", "rayonnement"],
    ),
    ("occupancy", &["anwesen", "präsenz", "praesenz", "presence", "occup", "belegung", "bezetting"]),
    ("valve", &["ventil", "valve", "klep", "vanne"]),
    ("flow", &["durchfluss", "volumenstrom", "debiet", "debit", "flow rate", "massenstrom"]),
    ("T_return", &["rücklauf", "ruecklauf", "return", "retour"]),
    ("T_forward", &["vorlauf", "supply", "forward", "aanvoer", "flow temp", "depart"]),
    ("T_out", &["aussen", "außen", "outdoor", "outside", "ambient", "buiten", "exterieur", "extérieur"]),
    (
        "P_heater",
        &[
            "heizleistung",
            "heizung",
            "heizkörper",
            "heizkoerper",
            "heater",
            "heating",
            "wärme",
            "waerme",
            "heat power",
            "verwarming",
            "chauffage",
        ],
    ),
    (
        "P_appliances",
        &["strom", "steckdose", "licht", "appliance", "electric", "plug", "lights", "verbrauch"],
    ),
    (
        "T_room",
        &[
            "raum", "room", "zimmer", "innen", "indoor", "inside", "küche", "kueche", "kitchen", "bad",
            "bath", "flur", "büro", "buero", "office", "kamer", "chambre", "salon", "binnen",
        ],
    ),
    ("T_room", &["temperatur", "temp", "°c"]),
    ("P_heater", &["leistung", "power", "puissance", "vermogen"]),
];

/// The beginning of what airs a room, which is no valve.
const AIRING: &str = "ventilat";

/// Words that say nothing of the room in which something is measured.
const GENERAL: [&str; 22] = [
    "temperatur",
    "temperature",
    "temperatuur",
    "temp",
    "t",
    "ist",
    "wert",
    "value",
    "istwert",
    "mean",
    "avg",
    "mittel",
    "mittelwert",
    "sensor",
    "fühler",
    "fuehler",
    "messwert",
    "degc",
    "c",
    "in",
    "innen",
    "der",
];

/// The words of a name, in lower case.
pub(super) fn words(name: &str) -> Vec<String> {
    let lower = name.to_lowercase();
    let split = lower.split(|letter: char| !letter.is_alphanumeric() && letter != '°');
    split.filter(|word| !word.is_empty()).map(str::to_owned).collect()
}

/// The channel that a name means.
pub(super) fn meaning(name: &str) -> Option<&'static str> {
    let text = format!("{} ", words(name).join(" ")).replace(AIRING, "");
    let means = |parts: &&[&str]| parts.iter().any(|part| text.contains(part));
    MEANINGS.iter().find(|(_, parts)| means(parts)).map(|(channel, _)| *channel)
}

/// What is left of the name of a room's temperature: the room.
pub(super) fn room_words(name: &str) -> Vec<String> {
    let mut left: Vec<String> =
        words(name).into_iter().filter(|word| !GENERAL.contains(&word.as_str())).collect();
    // `Wohnzimmertemperatur` is the temperature of the `Wohnzimmer`.
    for word in &mut left {
        for end in ["temperatur", "temperature", "temp"] {
            if let Some(stem) = word.strip_suffix(end).filter(|stem| stem.len() > 2) {
                *word = stem.to_owned();
            }
        }
    }
    left
}

/// A name as a part of that of a system: letters of ASCII, digits and `_`.
pub(super) fn slug(words: &[String]) -> String {
    let mut text = String::new();
    for letter in words.join("_").chars() {
        match letter {
            'ä' => text.push_str("ae"),
            'ö' => text.push_str("oe"),
            'ü' => text.push_str("ue"),
            'ß' => text.push_str("ss"),
            'é' | 'è' | 'ê' => text.push('e'),
            letter if letter.is_ascii_alphanumeric() || letter == '_' => text.push(letter),
            _ => {}
        }
    }
    text.truncate(40);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_leads_to_its_own_channel() {
        for (channel, parts) in MEANINGS {
            for part in parts {
                assert_eq!(meaning(part), Some(channel), "{part}");
            }
        }
        assert_eq!(meaning("Window kitchen"), Some("window_open"));
        assert_eq!(meaning("Ventilation"), None);
        assert_eq!(meaning("Heizventil Bad"), Some("valve"));
    }
}
