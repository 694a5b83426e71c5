//! The laws that ship. Each has a file, and two lines here.

pub mod open_loop;
pub mod pid;
pub mod pid_pair;
pub mod sliding_mode;
pub mod sliding_mode_paper;

use crate::catalogue::LawRow;

/// The laws that ship.
pub(crate) const SHIPPED: [LawRow; 5] = [
    LawRow::of::<sliding_mode::SlidingMode>(),
    LawRow::of::<sliding_mode_paper::SlidingModePaper>(),
    LawRow::of::<pid::Pid>(),
    LawRow::of::<pid_pair::PidPair>(),
    LawRow::of::<open_loop::OpenLoop>(),
];
