//! The average dry-weather influent of a town, by which plants are warmed up, previewed and put to the test.

/// The constant influent of the benchmark simulation model no. 1 (Gernaey et al. 2014): the flow in m3/d,
/// what it carries in g/m3, the alkalinity in mol/m3.
pub const DRY_INFLUENT: [(&str, f64); 14] = [
    ("Q", 18_446.0),
    ("S_I", 30.0),
    ("S_S", 69.5),
    ("X_I", 51.2),
    ("X_S", 202.32),
    ("X_BH", 28.17),
    ("X_BA", 0.0),
    ("X_P", 0.0),
    ("S_O", 0.0),
    ("S_NO", 0.0),
    ("S_NH", 31.56),
    ("S_ND", 6.95),
    ("X_ND", 10.59),
    ("S_ALK", 7.0),
];
