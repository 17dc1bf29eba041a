//! What users tell the service: documents and measurements, checked here and kept by the store.
//!
//! `models` takes models and effects into the `shared` catalogue that everybody reads. `system` is the
//! document of a room or a plant, `systems` keeps it. `windows` takes measurements in,
//! in the `turns` of their system, and `lay` lays them over what counts; `layout` proposes rooms and
//! neighbours from one window of many sensors.

mod lay;
pub mod layout;
pub mod models;
pub mod shared;
pub mod system;
pub mod systems;
pub mod turns;
pub mod windows;
