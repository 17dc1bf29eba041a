//! Rows as statements name their columns. What `derive(FromRow)` writes, without the driver's macros, which
//! would build the driver, and SQLite with it, a second time for the compiler.

/// Declares the struct of a row: every field is read from the column of its name.
macro_rules! row {
    ($(#[$about:meta])* $sight:vis struct $name:ident { $($field:ident: $type:ty),+ $(,)? }) => {
        $(#[$about])*
        $sight struct $name {
            $($field: $type),+
        }

        impl<'r, R> sqlx::FromRow<'r, R> for $name
        where
            R: sqlx::Row,
            &'static str: sqlx::ColumnIndex<R>,
            $($type: sqlx::Decode<'r, R::Database> + sqlx::Type<R::Database>,)+
        {
            fn from_row(row: &'r R) -> Result<Self, sqlx::Error> {
                Ok(Self { $($field: row.try_get(stringify!($field))?),+ })
            }
        }
    };
}
pub(super) use row;
