//! Identification: which plant explains the recordings?
//!
//! Recordings become `data`; `fit` simulates the plant under their inputs and takes the residual on the position;
//! `search` makes it small from a `start` with the optimisers of `optimiser`; `statistics` says what the result is worth,
//! and `residual_test` whether the model is right; `report` and `picture` show it, and `command` does all of this for the command line.

pub mod command;
pub mod data;
pub mod fit;
pub mod nominal_model;
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
