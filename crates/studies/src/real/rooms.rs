//! The measured rooms, and what drives each.

/// A room, and what is known to drive it.
pub struct Room {
    pub name: &'static str,
    pub file: &'static str,
    pub binds: &'static [&'static str],
    pub model: &'static str,
    /// The effects of which one must be named first; none where no window is known to show one.
    pub drivers: &'static [&'static str],
    /// Effects that never act there.
    pub decoys: &'static [&'static str],
    pub place: (f64, f64),
}

impl Room {
    /// Whether this channel is one of those that are known to drive it.
    pub fn driven_by(&self, channel: &str) -> bool {
        let reads = |driver: &str| match driver.split_once(':') {
            _ if driver.contains("solar_gain") => channel == "irradiance",
            Some((_, argument)) => channel == argument,
            None => false,
        };
        self.drivers.iter().any(|driver| reads(driver))
    }
}

/// The file of the house whose windows begin later.
pub const BELGIAN: &str = "belgian_house/belgian_house_10min.csv.gz";
const BLOCH: &str = "bloch_school/bloch_school.csv.gz";
const BASE: &str = "rc2+constant_gain+solar_gain";
const SOUTH: &[&str] = &["heat_emitter:T_supply_south_circuit", "heat_emitter:T_return_south_circuit"];
const WATER: &[&str] = &["heat_emitter:T_heating_water_0off"];
const PUMPS: &[&str] = &["metered_gain:P_pump_south", "metered_gain:P_pump_north"];

/// A room of the Belgian house.
const BELGIAN_ROOM: Room = Room {
    name: "",
    file: BELGIAN,
    binds: &[],
    model: BASE,
    drivers: &[],
    decoys: &["wind_infiltration"],
    place: (50.51, 3.71),
};

/// The rooms.
pub const ROOMS: [Room; 14] = [
    Room {
        name: "laundry",
        binds: &["T_room=T_laundry", "irradiance=irradiance_clear_sky"],
        drivers: &["metered_gain:P_appliances"],
        ..BELGIAN_ROOM
    },
    Room {
        name: "living room",
        binds: &["T_room=T_living_room", "irradiance=irradiance_clear_sky"],
        ..BELGIAN_ROOM
    },
    Room {
        name: "teen room",
        binds: &["T_room=T_teen_room", "irradiance=irradiance_clear_sky"],
        ..BELGIAN_ROOM
    },
    Room {
        name: "bathroom",
        binds: &["T_room=T_bathroom", "irradiance=irradiance_clear_sky"],
        ..BELGIAN_ROOM
    },
    Room {
        name: "nl_home1",
        file: "nl_home1/nl_home1.csv.gz",
        binds: &[],
        model: BASE,
        drivers: WATER,
        decoys: &[],
        place: (52.0, 5.0),
    },
    Room {
        name: "nl_home3",
        file: "nl_home3/nl_home3.csv.gz",
        binds: &[],
        model: BASE,
        drivers: WATER,
        decoys: &[],
        place: (52.0, 5.0),
    },
    Room {
        name: "radiator room",
        file: "dk_radiator_room/dk_radiator_room.csv.gz",
        binds: &[],
        model: BASE,
        drivers: &[
            "heat_emitter:T_radiator_supply_pipe",
            "heat_emitter:T_radiator_return_pipe",
            "heat_emitter:T_radiator_supply_pipe2",
            "heat_emitter:T_radiator_return_pipe2",
        ],
        decoys: &[],
        place: (56.0, 10.0),
    },
    Room {
        name: "hourly house",
        file: "darkgreybox_demo_house/darkgreybox_1h.csv",
        binds: &["T_room=T_indoor", "T_out=T_outdoor"],
        model: "rc2+constant_gain",
        drivers: &["companion:heat_input_raw", "heat_emitter:T_heating_supply"],
        decoys: &[],
        place: (51.5, 0.0),
    },
    Room {
        name: "office 999169",
        file: "brains4buildings_windesheim/room_999169_15min.csv",
        binds: &["T_room=T_room_bms", "T_out=T_outdoor", "irradiance=ghi"],
        model: "rc2+constant_gain",
        drivers: &["solar_gain", "envelope_solar_gain", "oriented_solar_gain:south"],
        decoys: &[],
        place: (52.5, 6.1),
    },
    Room {
        name: "office 917810",
        file: "brains4buildings_windesheim/room_917810_15min.csv",
        binds: &["T_room=T_room_bms", "T_out=T_outdoor", "irradiance=ghi"],
        model: "rc2+constant_gain",
        drivers: &[],
        decoys: &[],
        place: (52.5, 6.1),
    },
    Room {
        name: "FlexHouse",
        file: "dtu_flexhouse_prbs/flexhouse_5min.csv",
        binds: &["T_room=T_indoor", "T_out=T_outdoor", "irradiance=ghi"],
        model: "rc2+constant_gain+metered_gain:P_heater",
        drivers: &["solar_gain", "envelope_solar_gain", "oriented_solar_gain:south"],
        decoys: &[],
        place: (55.69, 12.1),
    },
    Room {
        name: "ou44 room 511",
        file: "ou44_room511/ou44_room511.csv.gz",
        binds: &[],
        model: BASE,
        drivers: &["companion:occupants_count", "companion:CO2", "companion:PIR"],
        decoys: &["wind_infiltration"],
        place: (55.37, 10.43),
    },
    Room {
        name: "bloch B140",
        file: BLOCH,
        binds: &["T_room=T_room_B140_south"],
        model: "rc2+constant_gain",
        drivers: SOUTH,
        decoys: PUMPS,
        place: (45.74, 3.19),
    },
    Room {
        name: "bloch B216",
        file: BLOCH,
        binds: &["T_room=T_room_B216_south"],
        model: "rc2+constant_gain",
        drivers: SOUTH,
        decoys: PUMPS,
        place: (45.74, 3.19),
    },
];
