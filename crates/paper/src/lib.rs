//! paper

pub mod identify;
pub mod reproduce;
