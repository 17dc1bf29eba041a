//! A day-ahead price of electricity: a shape that repeats, and days that differ.

use super::dice::Dice;

/// What every kilowatt-hour costs beside the market: the grid and the taxes, in EUR.
const DUTY: f64 = 0.08;
/// The mean of the market in EUR/kWh.
const MARKET: f64 = 0.14;
/// No hour is cheaper than the duty by more than this.
const CHEAPEST: f64 = -0.03;

/// The price of every hour in EUR/kWh, from midnight on: nights are cheap, mornings and evenings dear, noons
/// cheaper the more sun there is, and the level wanders from day to day.
pub(super) fn day_ahead(dice: &mut Dice, days: usize) -> Vec<f64> {
    let level = dice.wander(days, 0.25, 3.0);
    let mut prices = Vec::with_capacity(24 * days);
    for level in level {
        let (morning, noon, evening) =
            (dice.between(0.2, 0.7), dice.between(0.0, 0.4), dice.between(0.3, 1.1));
        for hour in 0..24 {
            let bump = |middle: f64, width: f64| (-((hour as f64 + 0.5 - middle) / width).powi(2)).exp();
            let shape = 0.75 + morning * bump(8.0, 1.8) - noon * bump(13.0, 2.5) + evening * bump(18.5, 2.0)
                - 0.25 * bump(3.0, 3.0);
            let market = MARKET * (shape * level.exp() + 0.05 * dice.normal());
            prices.push(DUTY + market.max(CHEAPEST));
        }
    }
    prices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evenings_are_dear_nights_are_cheap_and_no_day_is_like_another() {
        let prices = day_ahead(&mut Dice::new(3), 200);
        assert_eq!(prices, day_ahead(&mut Dice::new(3), 200));
        let mean = |hour: usize| prices.chunks(24).map(|day| day[hour]).sum::<f64>() / 200.0;
        assert!(mean(18) > 1.4 * mean(3), "{} {}", mean(18), mean(3));
        assert!(mean(8) > mean(13) && prices.iter().all(|price| (0.05..1.0).contains(price)));
        let days: Vec<f64> = prices.chunks(24).map(|day| day.iter().sum::<f64>() / 24.0).collect();
        let (low, high) =
            days.iter().fold((f64::MAX, 0.0f64), |(low, high), day| (low.min(*day), high.max(*day)));
        assert!(high > 1.5 * low, "days cost between {low} and {high}");
    }
}
