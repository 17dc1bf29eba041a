//! Openings of a window, read off sharp drops of a room temperature.
//!
//! Where no contact is fitted, a drop that is much steeper than the room's usual movement stands for an
//! opening. The column is made from the output itself, so whatever explains the output by it has to show more
//! than usual.

use super::computed::DROP;
use super::duration::MINUTE;
use super::grid::Grid;
use crate::fault::Fault;

/// A drop within half an hour counts when it is steeper than this many robust deviations of such changes.
const STEEP: f64 = 4.0;
/// And when it is at least this many K.
const LEAST: f64 = 0.3;
/// The span over which drops are looked for.
const SPAN: i64 = 30 * MINUTE;

/// The grid with the column `window_drop`: 1 while the temperature `output` falls sharply, else 0.
///
/// # Errors
/// A fault where the grid has no such output.
pub fn add_drops(grid: Grid, output: &str) -> Result<Grid, Fault> {
    let column = grid.require(output)?;
    let lead = (SPAN / grid.step()).max(1) as usize;
    let (values, valid) = (column.values(), column.valid());
    let change = |k: usize| {
        (k + lead < values.len() && valid[k] && valid[k + lead]).then(|| values[k + lead] - values[k])
    };
    let mut sizes: Vec<f64> = (0..values.len()).filter_map(change).map(f64::abs).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    // The median of the absolute values of a normal sample is 0.6745 deviations.
    let threshold = (STEEP * median / 0.6745).max(LEAST);
    let mut open = vec![0.0; values.len()];
    for k in 0..values.len() {
        if change(k).is_some_and(|change| change <= -threshold) {
            // The part of the span in which the temperature really falls.
            for step in k..k + lead {
                if values[step + 1] < values[step] {
                    open[step] = 1.0;
                }
            }
        }
    }
    grid.with_column(DROP.channel, DROP.column(open)?)
}

#[cfg(test)]
mod tests {
    use super::add_drops;
    use crate::data::{Column, DROPS, Grid, Hold, MINUTE};

    #[test]
    fn a_sharp_drop_is_an_opening_and_a_slow_night_is_none() {
        let mut values: Vec<f64> = (0..96).map(|k| 21.0 - 0.02 * f64::from(k)).collect();
        values.iter_mut().skip(41).for_each(|value| *value -= 1.0);
        let column = Column::complete("degC", Hold::Linear, values).unwrap();
        let grid = Grid::new(0, 15 * MINUTE, 96).unwrap().with_column("T_room", column).unwrap();
        let grid = add_drops(grid, "T_room").unwrap();
        let open: Vec<usize> = (0..96).filter(|k| grid.column(DROPS).unwrap().values()[*k] > 0.0).collect();
        assert!(open.contains(&40) && open.iter().all(|k| (39..=41).contains(k)), "{open:?}");
        assert!(add_drops(Grid::new(0, 15 * MINUTE, 4).unwrap(), "T_room").is_err());
    }
}
