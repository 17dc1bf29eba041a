//! Units of measurement: parsing, conversion, and the algebra that checks an equation.
//!
//! A unit is a vector of exponents over seven base units, a scale to those bases and, for temperatures
//! only, an offset. Base units: metre, kilogram, second, kelvin, mole, ampere and euro. Angles, fractions,
//! ppm and counts are pure numbers with a scale. Texts are products and quotients of known symbols with
//! integer exponents: `W/m2`, `1/h`, `K/h per m/s`, `g/m3`, `-`.

use serde::Serialize;
use utoipa::ToSchema;

/// A unit, as the exponents of m, kg, s, K, mol, A and EUR with a scale and an offset to the base units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    dims: Dimensions,
    scale: f64,
    offset: f64,
}

/// A unit text that could not be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownUnit(pub String);

impl std::fmt::Display for UnknownUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "`{}` is not a known unit", self.0)
    }
}

/// Largest exponent in a unit text.
pub const MAX_EXPONENT: i8 = 9;

/// The base units, in the order of the exponents.
pub const BASE: [&str; 7] = ["m", "kg", "s", "K", "mol", "A", "EUR"];

/// Exponents of the base units.
type Dimensions = [i8; 7];

/// A symbol that unit texts may use.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UnitSymbol {
    /// How it is written.
    pub symbol: &'static str,
    /// What it measures, in base units: `m2 kg s-3`; `-` for pure numbers.
    pub dimension: String,
    /// How many of the base units one of it is.
    pub factor: f64,
    /// What its zero is in base units, for temperatures that do not begin at absolute zero.
    pub offset: f64,
}

/// Every symbol that a unit text may use.
pub fn symbols() -> impl Iterator<Item = UnitSymbol> {
    SYMBOLS.iter().map(|(symbol, unit)| UnitSymbol {
        symbol,
        dimension: dimension(&unit.dims),
        factor: unit.scale,
        offset: unit.offset,
    })
}

/// Exponents as a unit text.
fn dimension(dims: &Dimensions) -> String {
    let powers = BASE.iter().zip(dims).filter(|(_, exponent)| **exponent != 0);
    let texts: Vec<String> = powers
        .map(|(base, exponent)| if *exponent == 1 { (*base).to_owned() } else { format!("{base}{exponent}") })
        .collect();
    if texts.is_empty() { "-".to_owned() } else { texts.join(" ") }
}

const fn unit(dims: Dimensions, scale: f64, offset: f64) -> Unit {
    Unit { dims, scale, offset }
}

const NUMBER: Dimensions = [0; 7];
const TEMPERATURE: Dimensions = [0, 0, 0, 1, 0, 0, 0];
const TIME: Dimensions = [0, 0, 1, 0, 0, 0, 0];
const LENGTH: Dimensions = [1, 0, 0, 0, 0, 0, 0];
const MASS: Dimensions = [0, 1, 0, 0, 0, 0, 0];
const FORCE: Dimensions = [1, 1, -2, 0, 0, 0, 0];
const POWER: Dimensions = [2, 1, -3, 0, 0, 0, 0];
const ENERGY: Dimensions = [2, 1, -2, 0, 0, 0, 0];
const PRESSURE: Dimensions = [-1, 1, -2, 0, 0, 0, 0];
const VOLUME: Dimensions = [3, 0, 0, 0, 0, 0, 0];
const CURRENT: Dimensions = [0, 0, 0, 0, 0, 1, 0];
const VOLTAGE: Dimensions = [2, 1, -3, 0, 0, -1, 0];
const RESISTANCE: Dimensions = [2, 1, -3, 0, 0, -2, 0];
const MONEY: Dimensions = [0, 0, 0, 0, 0, 0, 1];

/// Every symbol that a unit text may use.
const SYMBOLS: &[(&str, Unit)] = &[
    ("-", unit(NUMBER, 1.0, 0.0)),
    ("1", unit(NUMBER, 1.0, 0.0)),
    ("frac", unit(NUMBER, 1.0, 0.0)),
    ("0/1", unit(NUMBER, 1.0, 0.0)),
    ("pct", unit(NUMBER, 0.01, 0.0)),
    ("%", unit(NUMBER, 0.01, 0.0)),
    ("ppm", unit(NUMBER, 1e-6, 0.0)),
    ("people", unit(NUMBER, 1.0, 0.0)),
    ("rad", unit(NUMBER, 1.0, 0.0)),
    ("deg", unit(NUMBER, std::f64::consts::PI / 180.0, 0.0)),
    ("K", unit(TEMPERATURE, 1.0, 0.0)),
    ("degC", unit(TEMPERATURE, 1.0, 273.15)),
    ("C", unit(TEMPERATURE, 1.0, 273.15)),
    ("degF", unit(TEMPERATURE, 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0)),
    ("F", unit(TEMPERATURE, 5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0)),
    ("s", unit(TIME, 1.0, 0.0)),
    ("min", unit(TIME, 60.0, 0.0)),
    ("h", unit(TIME, 3600.0, 0.0)),
    ("d", unit(TIME, 86400.0, 0.0)),
    ("day", unit(TIME, 86400.0, 0.0)),
    ("m", unit(LENGTH, 1.0, 0.0)),
    ("cm", unit(LENGTH, 0.01, 0.0)),
    ("mm", unit(LENGTH, 0.001, 0.0)),
    ("km", unit(LENGTH, 1000.0, 0.0)),
    ("kg", unit(MASS, 1.0, 0.0)),
    ("g", unit(MASS, 1e-3, 0.0)),
    ("mg", unit(MASS, 1e-6, 0.0)),
    ("W", unit(POWER, 1.0, 0.0)),
    ("kW", unit(POWER, 1e3, 0.0)),
    ("MW", unit(POWER, 1e6, 0.0)),
    ("J", unit(ENERGY, 1.0, 0.0)),
    ("kJ", unit(ENERGY, 1e3, 0.0)),
    ("Wh", unit(ENERGY, 3.6e3, 0.0)),
    ("kWh", unit(ENERGY, 3.6e6, 0.0)),
    ("Pa", unit(PRESSURE, 1.0, 0.0)),
    ("hPa", unit(PRESSURE, 100.0, 0.0)),
    ("mbar", unit(PRESSURE, 100.0, 0.0)),
    ("l", unit(VOLUME, 1e-3, 0.0)),
    ("L", unit(VOLUME, 1e-3, 0.0)),
    ("mol", unit([0, 0, 0, 0, 1, 0, 0], 1.0, 0.0)),
    ("N", unit(FORCE, 1.0, 0.0)),
    ("kN", unit(FORCE, 1e3, 0.0)),
    ("Nm", unit(ENERGY, 1.0, 0.0)),
    ("A", unit(CURRENT, 1.0, 0.0)),
    ("mA", unit(CURRENT, 1e-3, 0.0)),
    ("V", unit(VOLTAGE, 1.0, 0.0)),
    ("kV", unit(VOLTAGE, 1e3, 0.0)),
    ("mV", unit(VOLTAGE, 1e-3, 0.0)),
    ("Ohm", unit(RESISTANCE, 1.0, 0.0)),
    ("EUR", unit(MONEY, 1.0, 0.0)),
];

impl Unit {
    /// The unit of a pure number.
    pub const ONE: Unit = unit(NUMBER, 1.0, 0.0);
    /// One hour, the time unit of every model.
    pub const HOUR: Unit = unit(TIME, 3600.0, 0.0);

    /// Reads a unit text.
    ///
    /// # Errors
    /// [`UnknownUnit`] when a symbol is not in the table or an exponent is not a small integer.
    pub fn parse(text: &str) -> Result<Unit, UnknownUnit> {
        let trimmed = text.trim();
        if let Some(whole) = symbol(trimmed) {
            return Ok(whole);
        }
        // "K/h per m/s" reads as (K/h) / (m/s).
        let mut parts = trimmed.split(" per ");
        let first = parts.next().unwrap_or_default();
        let mut result = parse_quotient(first).ok_or_else(|| UnknownUnit(trimmed.to_owned()))?;
        for part in parts {
            let divisor = parse_quotient(part).ok_or_else(|| UnknownUnit(trimmed.to_owned()))?;
            result = result.divided_by(divisor);
        }
        Ok(result)
    }

    /// Converts a value in this unit to `target`; `None` where the dimensions differ.
    pub fn convert(&self, target: &Unit, value: f64) -> Option<f64> {
        if self.dims != target.dims {
            return None;
        }
        if self == target {
            return Some(value);
        }
        Some((value * self.scale + self.offset - target.offset) / target.scale)
    }

    /// How many of `target` one of this unit is, where they differ by a factor alone.
    pub fn factor_to(&self, target: &Unit) -> Option<f64> {
        (self.dims == target.dims && self.offset == target.offset).then_some(self.scale / target.scale)
    }

    /// Whether both measure the same kind of quantity.
    pub fn same_dimension(&self, other: &Unit) -> bool {
        self.dims == other.dims
    }

    /// Whether a sum of the two is a sum of like quantities, without any conversion.
    pub fn addable(&self, other: &Unit) -> bool {
        self.dims == other.dims && (self.scale - other.scale).abs() <= 1e-9 * self.scale.abs()
    }

    /// Whether this is a pure number with scale one.
    pub fn is_number(&self) -> bool {
        self.addable(&Unit::ONE)
    }

    /// The factor that turns a pure number in this unit (deg, pct) into a plain one; `None` for anything with
    /// a dimension.
    pub fn number_scale(&self) -> Option<f64> {
        (self.dims == NUMBER).then_some(self.scale)
    }

    /// The unit of a product.
    #[must_use]
    pub fn times(self, other: Unit) -> Unit {
        let mut dims = self.dims;
        for (mine, theirs) in dims.iter_mut().zip(other.dims) {
            *mine = mine.saturating_add(theirs);
        }
        unit(dims, self.scale * other.scale, 0.0)
    }

    /// The unit of a quotient.
    #[must_use]
    pub fn divided_by(self, other: Unit) -> Unit {
        self.times(other.power(-1))
    }

    /// The unit of an integer power.
    #[must_use]
    pub fn power(self, exponent: i8) -> Unit {
        let mut dims = self.dims;
        for dim in &mut dims {
            *dim = dim.saturating_mul(exponent);
        }
        unit(dims, self.scale.powi(i32::from(exponent)), 0.0)
    }

    /// The unit of a square root; `None` where an exponent is odd.
    pub fn square_root(self) -> Option<Unit> {
        let mut dims = self.dims;
        for dim in &mut dims {
            if *dim % 2 != 0 {
                return None;
            }
            *dim /= 2;
        }
        Some(unit(dims, self.scale.sqrt(), 0.0))
    }
}

impl std::fmt::Display for Unit {
    /// Base units and scale, for error messages: `3600 s^-1 K`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some((name, _)) = SYMBOLS.iter().find(|(_, known)| known.addable(self)) {
            return write!(f, "{name}");
        }
        // Models count time in hours, so a rate reads best per hour.
        let hours = Unit::HOUR.power(self.dims[2]);
        let scale = self.scale / hours.scale;
        if (scale - 1.0).abs() > 1e-9 {
            write!(f, "{scale:.4} ")?;
        }
        let mut first = true;
        for (dim, base) in self.dims.iter().zip(BASE) {
            let name = if base == "s" { "h" } else { base };
            if *dim != 0 {
                write!(f, "{}{name}", if first { "" } else { " " })?;
                if *dim != 1 {
                    write!(f, "^{dim}")?;
                }
                first = false;
            }
        }
        Ok(())
    }
}

fn symbol(text: &str) -> Option<Unit> {
    SYMBOLS.iter().find(|(name, _)| *name == text).map(|(_, known)| *known)
}

/// `a b/c/d` with integer exponents behind each symbol.
fn parse_quotient(text: &str) -> Option<Unit> {
    let mut result = Unit::ONE;
    for (place, factors) in text.split('/').enumerate() {
        for factor in factors.split([' ', '*']).filter(|factor| !factor.is_empty()) {
            let power = parse_power(factor)?;
            result = if place == 0 { result.times(power) } else { result.divided_by(power) };
        }
    }
    (!text.trim().is_empty()).then_some(result)
}

/// `m2`, `m^-3`, `kW`.
fn parse_power(text: &str) -> Option<Unit> {
    if let Some(plain) = symbol(text) {
        return Some(plain);
    }
    let split = text.find(|c: char| c.is_ascii_digit() || c == '^' || c == '-')?;
    let base = symbol(&text[..split])?;
    let exponent: i8 = text[split..].trim_start_matches('^').parse().ok()?;
    (-MAX_EXPONENT..=MAX_EXPONENT).contains(&exponent).then(|| base.power(exponent))
}

/// An error of a temperature in degC is in K.
pub fn error_unit(unit: &str) -> &str {
    if unit == "degC" { "K" } else { unit }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Unit {
        Unit::parse(text).unwrap()
    }

    #[test]
    fn conversions_match_the_definitions() {
        let close = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-9, "{a:?} {b}");
        close(parse("degF").convert(&parse("degC"), 212.0), 100.0);
        close(parse("K").convert(&parse("degC"), 293.15), 20.0);
        close(parse("W").convert(&parse("kW"), 1500.0), 1.5);
        close(parse("km/h").convert(&parse("m/s"), 36.0), 10.0);
        close(parse("pct").convert(&parse("-"), 35.0), 0.35);
        close(parse("1/s").convert(&parse("1/h"), 1.0), 3600.0);
        close(parse("V A").convert(&parse("kW"), 2300.0), 2.3);
        close(parse("V/Ohm").convert(&parse("mA"), 0.5), 500.0);
        close(parse("N m/s").convert(&parse("W"), 7.0), 7.0);
        close(parse("Nm rad/s").convert(&parse("kW"), 1e3), 1.0);
        close(parse("EUR/MW h").factor_to(&parse("EUR/kW h")), 1e-3);
        assert!(parse("V").convert(&parse("A"), 1.0).is_none());
        assert_eq!(parse("W").convert(&parse("degC"), 1.0), None);
    }

    #[test]
    fn the_algebra_knows_a_rate_from_a_temperature() {
        let rate = parse("1/h").times(parse("K"));
        assert!(rate.addable(&parse("K/h")));
        assert!(rate.addable(&parse("K").divided_by(Unit::HOUR)));
        assert!(!rate.addable(&parse("K/s")));
        assert!(parse("K/h per m/s").times(parse("m/s")).addable(&parse("K/h")));
        assert!(parse("W/m2").addable(&parse("W m^-2")));
        assert!(Unit::parse("furlong").is_err());
        assert!(Unit::parse("").is_err());
    }

    #[test]
    fn the_dimension_of_a_symbol_is_a_unit_text_of_the_same_kind() {
        for known in symbols() {
            assert!(parse(&known.dimension).same_dimension(&parse(known.symbol)), "{known:?}");
        }
        let watt = symbols().find(|known| known.symbol == "kW").unwrap();
        assert_eq!((watt.dimension.as_str(), watt.factor), ("m2 kg s-3", 1000.0));
    }
}
