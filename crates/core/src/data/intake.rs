//! Single values on their way to a channel, where no column says what they are: of the line protocol, say.

use super::channel::ChannelKind;
use super::header::{ColumnHeader, ColumnUnit, Target, target};
use crate::fault::Fault;

/// How numbers in a unit become values of a channel.
#[derive(Debug)]
pub struct ChannelIntake {
    target: Target,
}

impl ChannelIntake {
    /// The way of numbers in this unit to this channel; without one they are in the channel's own.
    ///
    /// # Errors
    /// A fault where the unit is none, or does not convert to that of the channel.
    pub fn new(channel: &str, unit: Option<&str>) -> Result<Self, Fault> {
        let header = match unit {
            Some(unit) => ColumnHeader::with_unit(channel, unit),
            None => ColumnHeader {
                column: channel.to_owned(),
                channel: channel.to_owned(),
                unit: ColumnUnit::Unstated,
                role: None,
            },
        };
        // What is told of a column, that its unit was assumed, is told of every one here.
        target(0, channel, &header, &|_| "/unit".to_owned(), &mut Vec::new()).map(|target| Self { target })
    }

    /// What is known of the channel.
    pub fn kind(&self) -> &ChannelKind {
        &self.target.kind
    }

    /// The value of the channel that a number stands for; `None` where no working sensor gives it.
    pub fn value(&self, number: f64) -> Option<f64> {
        let value = self.target.from.convert(&self.target.to, number)?;
        self.target.kind.is_plausible(value).then_some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::ChannelIntake;

    #[test]
    fn numbers_are_converted_and_what_no_sensor_gives_is_none() {
        let power = ChannelIntake::new("P_heater", Some("W")).unwrap();
        assert_eq!((power.value(1500.0), power.value(1e9)), (Some(1.5), None));
        let room = ChannelIntake::new("T_room", None).unwrap();
        assert_eq!((room.value(20.5), room.value(85.0), room.value(f64::NAN)), (Some(20.5), None, None));
        assert_eq!(ChannelIntake::new("T_room", Some("°F")).unwrap().value(68.0).map(f64::round), Some(20.0));
        assert_eq!(ChannelIntake::new("T_room", Some("kW")).unwrap_err().code, "inconvertible-unit");
        assert_eq!(ChannelIntake::new("T_room", Some("furlong")).unwrap_err().code, "unknown-unit");
    }
}
