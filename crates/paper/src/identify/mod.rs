//! Identification: finds the plant that explains recordings.
//!
//! `data` reads recordings. `fit` simulates the plant under their inputs and takes the residual of the position.
//! `search` minimises the residual from a `start` with the optimisers of `optimiser`. `statistics` rates the result,
//! and `residual_test` tests the model. `report` and `picture` show them. `command` does all of this for the command
//! line.

pub mod command;
pub mod data;
pub mod fit;
pub mod optimiser;
pub mod parameter;
pub mod picture;
pub mod played;
pub mod report;
pub mod residual_test;
pub mod search;
pub mod sensor_model;
pub mod start;
pub mod statistics;
