//! What users tell the service: documents and measurements, checked here and kept by the store.
//!
//! `models` takes models and effects into the `shared` catalogue that everybody reads; `proposed` says from
//! when on all systems are tried with what was proposed for one. `system` is the
//! document of a room or a plant, `systems` keeps it. `windows` takes measurements in, in the `turns` of
//! their system, and `lay` lays them over what counts; `samples` takes live ones, which stay `open` for a
//! while (`kept_posts` counts them), and `forecasts` what is forecast of inputs. `layout` proposes rooms and
//! neighbours from one window of many sensors. `lines` takes lines of InfluxDB's protocol in, which the
//! `line_rules` of an operator, made of `pattern`s, sort into systems and channels; `prometheus` says whom to
//! ask for more.

pub mod forecasts;
pub mod kept_posts;
mod lay;
pub mod layout;
pub mod line_rules;
pub mod lines;
pub mod models;
pub mod open;
mod pattern;
pub mod prometheus;
pub mod proposed;
pub mod samples;
pub mod shared;
pub mod system;
pub mod systems;
pub mod turns;
pub mod windows;
