//! Watch over a real drive: in spite of any scenario, controller or plant, no limit of the rig is violated for longer than a
//! frame takes.

use std::time::Duration;

use can::{CanFrame, Filter};
use canopen::NmtCommand;
use canopen::cia402::Command;
use plan::loaded_drive::LoadedDrive;
use scenario::port::Unit;
use scenario::rig::drive::DriveLayout;
use scenario::rig::limits::LimitWatch;

/// Part of the bench's node that switches the current of a drive off.
#[derive(Debug)]
pub(crate) struct Supervisor {
    drive: DriveLayout,
    watch: LimitWatch,
}

impl Supervisor {
    /// Makes a supervisor that has seen no frame.
    pub(crate) fn new(drive: &LoadedDrive, sync_period: Duration, unit: &Unit) -> Self {
        Self {
            drive: drive.layout.clone(),
            watch: LimitWatch::new(&drive.real.limits, sync_period, unit),
        }
    }

    /// Returns the filters for the frames that it must receive.
    pub(crate) fn filters(&self) -> [Filter; 2] {
        [&self.drive.feedback, &self.drive.command].map(|pdo| Filter::exact(pdo.id()))
    }

    /// Checks a frame of the bus; describes the violation of a limit.
    pub(crate) fn check(&mut self, now: Duration, frame: &CanFrame) -> Option<String> {
        match (self.drive.decode(frame), self.drive.decode_target(frame)) {
            (Some(feedback), _) => self.watch.check(now, &feedback),
            (_, Some(amperes)) => self.watch.check_command(amperes),
            _ => None,
        }
    }

    /// Returns the emergency stop: command 0 with quick stop for a drive that takes it at once, and NMT stop, after which no
    /// drive may follow PDOs.
    pub(crate) fn stop(&self) -> [CanFrame; 2] {
        let quick_stop = self.drive.encode(Command::QuickStop.controlword(), 0.0);
        let stop = NmtCommand::Stop.frame(Some(self.drive.node_id));
        [quick_stop, stop]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scenario::rig::{Limits, RealDrive, RigDrive};

    fn supervisor() -> Supervisor {
        let limits = Limits {
            current_amperes: 0.9,
            min: -1.0,
            max: 45.0,
            rate_max: 400.0,
        };
        let real = RealDrive::new(RigDrive::default(), limits);
        let drive = LoadedDrive::new(real, None).unwrap();
        Supervisor::new(&drive, Duration::from_millis(1), &Unit::default())
    }

    fn feedback(micrometres: i32, milliamperes: i16) -> CanFrame {
        let mut data = [0x37, 2, 0, 0, 0, 0, 0, 0];
        data[2..6].copy_from_slice(&micrometres.to_le_bytes());
        data[6..].copy_from_slice(&milliamperes.to_le_bytes());
        CanFrame::new(0x190, &data)
    }

    /// Returns the report after these frames, 10 ms apart.
    fn after(frames: &[CanFrame]) -> Option<String> {
        let mut supervisor = supervisor();
        let times = (0..).map(|cycle| Duration::from_millis(10) * cycle);
        let mut found = times.zip(frames);
        let violation = found.find_map(|(now, frame)| supervisor.check(now, frame));
        violation.map(|violation| violation.to_string())
    }

    #[test]
    fn each_limit_is_watched() {
        let command = |permille: i16| {
            let [low, high] = permille.to_le_bytes();
            CanFrame::new(0x210, &[0x0F, 0, low, high])
        };
        let still = feedback(10_000, 500);
        for violating in [
            feedback(46_000, 0),
            feedback(-1_100, 0),
            feedback(10_000, 950),
            feedback(10_000, -950),
            command(901),
            command(-901),
        ] {
            let violation = after(&[still, violating]);
            assert!(violation.unwrap().starts_with("limit of the rig: "));
        }
        let violation = after(&[feedback(0, 0), feedback(5_000, 0), feedback(10_000, 0)]);
        assert_eq!(
            violation.unwrap(),
            "limit of the rig: the load moves at 500 mm/s (limit 400 mm/s)"
        );
        assert!(after(&[feedback(10_000, 0), feedback(5_000, 0), feedback(0, 0)]).is_some());
        let allowed = [still, command(900), command(-900), feedback(10_000, -940)];
        assert_eq!(after(&allowed), None);
    }
}
