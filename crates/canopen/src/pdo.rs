//! Process data objects (CiA 301, 7.2.2, 7.5.2.35 to 7.5.2.38): parameters, mapping, reception and transmission.
//!
//! Mapping is by bytes: at most eight objects and 64 bits. A mapping is written in the standard's order: destroy the
//! PDO (bit 31), write 0 to sub-index 0, write the entries, write their number, create the PDO. Another order is
//! refused with [`AbortCode::UNSUPPORTED_ACCESS`].

mod configuration;
mod receive;
mod transmit;

pub(crate) use configuration::{Direction, Place, check_write, places};
pub use configuration::{Mapping, identifier};
pub(crate) use receive::Rpdo;
pub use receive::WaitingPdo;
pub(crate) use transmit::Tpdo;
