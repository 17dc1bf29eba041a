//! The canonical elementary functions: branch-free, so that a loop over lanes vectorises, and the same
//! bits on every CPU, because only correctly rounded operations and no fused multiply-add are used.
//!
//! `std` functions may differ between platforms and do not vectorise. These stay within about two units
//! in the last place of the true value on the ranges that a model meets; the tests compare with `std`.

/// Adding and subtracting this rounds to the nearest integer and leaves that integer in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;
const LN2_HIGH: f64 = 6.931_471_803_691_238e-1;
const LN2_LOW: f64 = 1.908_214_929_270_587_7e-10;

/// `e^x`. Zero below -708 (no subnormal results), infinite above 709.78.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * LN2_HIGH) - k * LN2_LOW;
    // Taylor's series on |r| <= ln(2)/2; its last term is below half a unit in the last place.
    let mut p = 1.0 / 6_227_020_800.0;
    p = p * r + 1.0 / 479_001_600.0;
    p = p * r + 1.0 / 39_916_800.0;
    p = p * r + 1.0 / 3_628_800.0;
    p = p * r + 1.0 / 362_880.0;
    p = p * r + 1.0 / 40_320.0;
    p = p * r + 1.0 / 5_040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r * r + r + 1.0;
    let scaled = f64::from_bits((shifted.to_bits() << 52).wrapping_add(p.to_bits()));
    let low = if x < -708.0 { 0.0 } else { scaled };
    let high = if x > 709.78 { f64::INFINITY } else { low };
    if x.is_nan() { x } else { high }
}

/// The natural logarithm (fdlibm's reduction and polynomial). Zero gives minus infinity, a negative NaN.
#[inline(always)]
pub fn log(x: f64) -> f64 {
    // Move the mantissa to [sqrt(1/2), sqrt(2)).
    let bits = x.to_bits().wrapping_add(0x3ff0_0000_0000_0000 - 0x3fe6_a09e_667f_3bcd);
    // The biased exponent as a double, without an integer conversion that AVX2 lacks.
    let e = f64::from_bits((bits >> 52) | 0x4330_0000_0000_0000) - (4_503_599_627_370_496.0 + 1023.0);
    let m = f64::from_bits((bits & 0x000f_ffff_ffff_ffff).wrapping_add(0x3fe6_a09e_667f_3bcd));
    let f = m - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    let mut r = 1.479_819_860_511_658_6e-1;
    r = r * z + 1.531_383_769_920_937_3e-1;
    r = r * z + 1.818_357_216_161_805e-1;
    r = r * z + 2.222_219_843_214_978_4e-1;
    r = r * z + 2.857_142_874_366_239e-1;
    r = r * z + 3.999_999_999_940_942e-1;
    r = r * z + 6.666_666_666_666_735e-1;
    r *= z;
    let half_square = 0.5 * f * f;
    let value = e * LN2_HIGH - ((half_square - (s * (half_square + r) + e * LN2_LOW)) - f);
    let positive = if x < f64::INFINITY { value } else { x };
    let zero = if x < f64::MIN_POSITIVE { f64::NEG_INFINITY } else { positive };
    if x < 0.0 { f64::NAN } else { zero }
}

/// `sin(x)`; NaN beyond a hundred million, where the reduction would lose its digits.
#[inline(always)]
pub fn sin(x: f64) -> f64 {
    sine_of_quadrant(x, 0)
}

/// `cos(x)`; NaN beyond a hundred million.
#[inline(always)]
pub fn cos(x: f64) -> f64 {
    sine_of_quadrant(x, 1)
}

#[inline(always)]
fn sine_of_quadrant(x: f64, ahead: u64) -> f64 {
    let shifted = x * std::f64::consts::FRAC_2_PI + ROUND;
    let n = shifted - ROUND;
    // pi/2 in pieces of 33 bits: their products with n are exact (Cody and Waite; fdlibm's constants).
    let r =
        ((x - n * 1.570_796_326_734_125_6) - n * 6.077_100_506_303_966e-11) - n * 2.022_266_248_795_950_7e-21;
    let z = r * r;
    let mut s = 1.589_690_995_211_55e-10;
    s = s * z - 2.505_076_025_340_686_3e-8;
    s = s * z + 2.755_731_370_707_006_8e-6;
    s = s * z - 1.984_126_982_985_795e-4;
    s = s * z + 8.333_333_333_322_49e-3;
    s = s * z - 1.666_666_666_666_663_2e-1;
    let sine = r + r * z * s;
    let mut c = -1.135_964_755_778_819_5e-11;
    c = c * z + 2.087_572_321_298_175e-9;
    c = c * z - 2.755_731_435_139_066_3e-7;
    c = c * z + 2.480_158_728_947_673e-5;
    c = c * z - 1.388_888_888_887_411e-3;
    c = c * z + 4.166_666_666_666_66e-2;
    let cosine = 1.0 - 0.5 * z + z * z * c;
    let quadrant = shifted.to_bits().wrapping_add(ahead);
    let value = if quadrant & 1 == 0 { sine } else { cosine };
    let signed = if quadrant & 2 == 0 { value } else { -value };
    if x.abs() <= 1e8 { signed } else { f64::NAN }
}

/// `tanh(x)`: a continued fraction near zero, where the exponential form cancels.
#[inline(always)]
pub fn tanh(x: f64) -> f64 {
    let z = x * x;
    let near = x / (1.0 + z / (3.0 + z / (5.0 + z / (7.0 + z / (9.0 + z / (11.0 + z / 13.0))))));
    let far = 1.0 - 2.0 / (exp(2.0 * x) + 1.0);
    if x.abs() < 0.3 { near } else { far }
}

/// `base^exponent` for a base that is not negative; zero to any positive power is zero.
#[inline(always)]
pub fn pow(base: f64, exponent: f64) -> f64 {
    let value = exp(exponent * log(base));
    if exponent == 0.0 { 1.0 } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst(range: (f64, f64), ours: fn(f64) -> f64, theirs: fn(f64) -> f64, absolute: bool) -> f64 {
        let n = 20_011;
        (0..=n)
            .map(|i| range.0 + (range.1 - range.0) * f64::from(i) / f64::from(n))
            .map(|x| {
                let error = (ours(x) - theirs(x)).abs();
                if absolute { error } else { error / theirs(x).abs().max(f64::MIN_POSITIVE) }
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn agree_with_the_standard_library() {
        assert!(worst((-700.0, 700.0), exp, f64::exp, false) < 6e-16);
        assert!(worst((-1.0, 1.0), exp, f64::exp, false) < 6e-16);
        assert!(worst((1e-9, 50.0), log, f64::ln, true) < 2e-15);
        assert!(worst((0.9, 1.1), log, f64::ln, true) < 3e-16);
        assert!(worst((-400.0, 400.0), sin, f64::sin, true) < 4e-16);
        assert!(worst((-400.0, 400.0), cos, f64::cos, true) < 4e-16);
        assert!(worst((-20.0, 20.0), tanh, f64::tanh, true) < 5e-16);
        assert!((pow(0.37, 3.4) - 0.37f64.powf(3.4)).abs() < 1e-15);
    }

    #[test]
    fn the_edges_are_defined() {
        assert_eq!(exp(f64::NEG_INFINITY), 0.0);
        assert_eq!(exp(1e3), f64::INFINITY);
        assert!(exp(f64::NAN).is_nan());
        assert_eq!(log(0.0), f64::NEG_INFINITY);
        assert!(log(-1.0).is_nan());
        assert!(log(f64::NAN).is_nan());
        assert_eq!(log(f64::INFINITY), f64::INFINITY);
        assert_eq!(pow(0.0, 3.4), 0.0);
        assert!(sin(1e12).is_nan());
    }
}
