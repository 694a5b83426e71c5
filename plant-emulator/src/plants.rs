//! The plants that ship. Each has a file or folder, and two lines here.

mod condition;
pub mod dc_motor;
pub mod sma;

use crate::catalogue::PlantRow;

/// Acceleration of gravity `g`, m/s².
const GRAVITY: f64 = 9.806_65;

/// The plants that ship.
pub(crate) const SHIPPED: [PlantRow; 3] = [
    PlantRow::of::<sma::Actuator>(),
    PlantRow::of::<dc_motor::DcMotor>(),
    PlantRow::of::<sma::pair::SmaPair>(),
];
