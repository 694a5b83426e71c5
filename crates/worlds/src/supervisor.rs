//! Watch over a real drive: in spite of any scenario, controller or plant, no limit of the rig is violated for longer than a
//! frame takes.

use std::time::Duration;

use can::{CanFrame, Filter};
use canopen::cia402::Command;
use canopen::{NmtCommand, NodeId};
use plan::ControlLoop;
use scenario::rig::drive::DriveLayout;
use scenario::rig::limits::LimitWatch;

/// Part of the bench's node that switches off the current of a drive that is not the emulator.
#[derive(Debug)]
pub(crate) struct Supervisor {
    /// Name of the drive, for messages.
    pub(crate) name: String,
    node_id: Option<NodeId>,
    /// The drive with its limits, if a rig file gives them.
    limited: Option<(DriveLayout, LimitWatch)>,
}

impl Supervisor {
    /// Makes a supervisor of a loop's drive that has seen no frame.
    pub(crate) fn new(one: &ControlLoop) -> Self {
        let sync_period = one.trial.run.bus.sync_period();
        let unit = &one.trial.wiring.sensor.quantity.unit;
        let limited = one.real_drive.as_ref().map(|drive| {
            let watch = LimitWatch::new(&drive.real.limits, sync_period, unit);
            (drive.layout.clone(), watch)
        });
        Self {
            name: one.drive().name.clone(),
            node_id: NodeId::new(one.drive().id()),
            limited,
        }
    }

    /// Returns the filters for the frames that it must receive.
    pub(crate) fn filters(&self) -> impl Iterator<Item = Filter> {
        let drives = self.limited.iter();
        let pdos = drives.flat_map(|(drive, _)| [&drive.feedback, &drive.command]);
        pdos.map(|pdo| Filter::exact(pdo.id()))
    }

    /// Checks a frame of the bus; describes the violation of a limit.
    pub(crate) fn check(&mut self, now: Duration, frame: &CanFrame) -> Option<String> {
        let (drive, watch) = self.limited.as_mut()?;
        match (drive.decode(frame), drive.decode_target(frame)) {
            (Some(feedback), _) => watch.check(now, &feedback),
            (_, Some(amperes)) => watch.check_command(amperes),
            _ => None,
        }
    }

    /// Returns the emergency stop: command 0 with quick stop for a drive that takes it at once, and NMT stop, after which no
    /// drive may follow PDOs.
    pub(crate) fn stop(&self) -> impl Iterator<Item = CanFrame> {
        let limited = self.limited.iter();
        let quick_stop = Command::QuickStop.controlword();
        let quick_stops = limited.map(move |(drive, _)| drive.encode(quick_stop, 0.0));
        quick_stops.chain([NmtCommand::Stop.frame(self.node_id)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbc::Unit;
    use plan::loaded_drive::LoadedDrive;
    use scenario::rig::{Limits, RealDrive};

    fn supervisor() -> Supervisor {
        let limits = Limits {
            current_amperes: 0.9,
            min: -1.0,
            max: 45.0,
            rate_max: 400.0,
        };
        let drive = LoadedDrive::new(RealDrive::new(limits), None).unwrap();
        let period = Duration::from_millis(1);
        let watch = LimitWatch::new(&drive.real.limits, period, &Unit::default());
        Supervisor {
            name: "drive".to_owned(),
            node_id: NodeId::new(0x10),
            limited: Some((drive.layout, watch)),
        }
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
        let received = can::FilterSet::from(Vec::from_iter(supervisor().filters()));
        for violating in [
            feedback(46_000, 0),
            feedback(-1_100, 0),
            feedback(10_000, 950),
            feedback(10_000, -950),
            command(901),
            command(-901),
        ] {
            assert!(received.accepts(&violating), "{violating}");
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
