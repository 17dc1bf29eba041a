//! Rows as statements name their columns. What `derive(FromRow)` writes, without the driver's macros, which
//! would build the driver, and SQLite with it, a second time for the compiler.

/// Declares the struct of a row: every field is read from the column of its name.
macro_rules! row {
    ($(#[$about:meta])* $sight:vis struct $name:ident { $($field:ident: $type:ty),+ $(,)? }) => {
        $(#[$about])*
        $sight struct $name {
            $($field: $type),+
        }

        impl sqlx::FromRow<'_, sqlx::sqlite::SqliteRow> for $name {
            fn from_row(row: &sqlx::sqlite::SqliteRow) -> Result<Self, sqlx::Error> {
                Ok(Self { $($field: sqlx::Row::try_get(row, stringify!($field))?),+ })
            }
        }
    };
}
pub(super) use row;
