//! A controller that leads two drives in two loops.

use scenario::Identifiers;

use super::*;

const SECOND: NodeId = NodeId::new(0x12).unwrap();
const FIRST_CURRENT: &str =
    "[[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.25\n";
const SECOND_CURRENT: &str =
    "[[controller.open_loop.step]]\nat_seconds = 0.0\ncurrent_amperes = 0.5\n";
/// 0.25 A and 0.5 A in thousandths of 1 A, after the controlword "enable operation".
const FIRST_COMMAND: [u8; 4] = [0x0F, 0, 250, 0];
const SECOND_COMMAND: [u8; 4] = [0x0F, 0, 0xF4, 1];
const QUICK_STOP: u8 = 0x02;

fn bus() -> Bus {
    bus_with([FIRST_CURRENT, SECOND_CURRENT])
}

fn bus_with(tables: [&str; 2]) -> Bus {
    let mut views = tables.map(view);
    for (number, (view, node_id)) in (0..).zip(views.iter_mut().zip([DRIVE, SECOND])) {
        let controller = RigNode::canopen("controller", 0x01, Profile::Manager);
        let drive = RigNode::canopen("drive", node_id.get(), Profile::Drive);
        let nodes = Nodes::new([controller, drive]).unwrap();
        let drive = nodes.find("drive").unwrap();
        (view.wiring.drive, view.wiring.followed) = (drive, drive);
        view.wiring.set_nodes(&nodes);
        view.wiring.identifiers = Identifiers::new(1, node_id.get(), number);
    }
    let plans = views.iter().map(|view| LoopPlan::new(view, None).unwrap());
    let controller = Leader::leading(plans.collect(), vec![DISTURBANCE], &no_player);
    Bus {
        controller: controller.unwrap(),
        second: Some(drive(SECOND)),
        ..Bus::new(OPEN_LOOP)
    }
}

impl Bus {
    fn second(&mut self) -> &mut Device<TestDrive> {
        self.second.as_mut().unwrap()
    }

    /// Breaks the second drive from its boot on.
    fn break_second(&mut self) {
        self.second().on_tick(Duration::ZERO);
        let drive = self.second().application_mut();
        drive.machine.on_fault();
        drive.is_broken = true;
    }

    /// Returns the RPDO1 of each drive from a time on.
    fn commands(&self, from: Duration) -> [Vec<CanFrame>; 2] {
        [0x210, 0x212].map(|id| self.frames(id, from))
    }

    #[track_caller]
    fn both_are_stopped(&mut self) {
        assert!(!self.drive().application().is_heating());
        assert!(!self.second().application().is_heating());
        for node in [DRIVE, SECOND] {
            let stop = NmtCommand::Stop.frame(Some(node));
            assert!(self.has_sent(&stop), "node {node} was not stopped");
        }
        for commands in self.commands(Duration::ZERO) {
            assert_eq!(commands.last().unwrap().data()[..4], [QUICK_STOP, 0, 0, 0]);
        }
    }
}

#[test]
fn each_drive_gets_the_command_of_its_own_loop() {
    let mut bus = bus();
    bus.run_until_running();
    let from = bus.now;
    bus.run_for(10 * MILLISECOND);
    for (commands, wanted) in bus
        .commands(from)
        .iter()
        .zip([FIRST_COMMAND, SECOND_COMMAND])
    {
        assert!(commands.len() >= 10, "{}", commands.len());
        for command in commands {
            assert_eq!(command.data()[..4], wanted);
        }
    }
    let starts = [DRIVE, SECOND].map(|node| {
        let start = NmtCommand::Start.frame(Some(node));
        bus.log
            .iter()
            .position(|(_, frame)| *frame == start)
            .unwrap()
    });
    assert_eq!(starts[1], starts[0] + 1, "both are started together");
}

#[test]
fn time_0_waits_for_the_last_drive_and_until_then_every_command_is_0() {
    let mut bus = bus();
    bus.break_second();
    bus.run_for(Duration::from_secs(1));
    assert!(!bus.is_running());
    for command in bus.commands(Duration::ZERO).concat() {
        assert_eq!(command.data()[2..4], [0, 0]);
    }
    let first = bus.commands(bus.now - 10 * MILLISECOND)[0].clone();
    assert!(
        first.len() >= 10,
        "the first drive is led on while it waits"
    );
    bus.second().application_mut().is_broken = false;
    bus.run_until_running();
    bus.run_for(10 * MILLISECOND);
    let [first, second] = bus.commands(Duration::ZERO);
    let led_at = |commands: &[CanFrame], wanted: [u8; 4]| {
        let from_the_end = commands.iter().rev();
        from_the_end
            .take_while(|command| command.data()[..4] == wanted)
            .count()
    };
    let cycles = led_at(&first, FIRST_COMMAND);
    assert!(cycles >= 10, "{cycles}");
    assert_eq!(cycles, led_at(&second, SECOND_COMMAND));
}

#[test]
fn a_drive_that_is_not_there_is_named() {
    let mut bus = bus();
    bus.second = None;
    let text =
        "no drive: node 18 sent no boot-up message or heartbeat and answered no SDO for 10 s";
    assert_eq!(bus.ending(), Progress::Failed(text.to_owned()));
    let commands = bus.commands(Duration::ZERO).concat();
    assert!(commands.is_empty(), "{commands:?}");
}

#[test]
fn a_drive_that_never_reaches_operation_enabled_is_named() {
    let mut bus = bus();
    bus.break_second();
    let Progress::Failed(text) = bus.ending() else {
        panic!("the run goes on");
    };
    let start = "the drive (node 18) did not reach Operation enabled within 2 s; its last statusword was 0x";
    assert!(text.starts_with(start), "{text}");
    bus.both_are_stopped();
}

#[test]
fn a_drive_that_is_lost_takes_the_current_from_the_others_too() {
    let mut bus = bus();
    bus.run_until_running();
    bus.lost = Some(0x192);
    let text = "no position from the drive (node 18, frame 0x192) in 21 cycles (limit 20)";
    let ending = bus.ending();
    assert_eq!(ending, Progress::Failed(text.to_owned()));
    bus.both_are_stopped();

    let mut bus = self::bus();
    bus.run_until_running();
    let second = bus.second.take().unwrap();
    let Progress::Failed(text) = bus.ending() else {
        panic!("the run goes on");
    };
    bus.second = Some(second);
    assert!(text.contains("node 18"), "{text}");
    assert!(!bus.drive().application().is_heating());
}

#[test]
fn a_loop_without_a_position_sends_no_command_and_the_other_goes_on() {
    let mut bus = bus();
    bus.run_until_running();
    bus.run_for(MILLISECOND / 2);
    let from = bus.now;
    bus.lost = Some(0x192);
    bus.run_for(3 * MILLISECOND);
    bus.lost = None;
    let [first, second] = bus.commands(from);
    assert!(first.len() >= 3, "{}", first.len());
    assert!(second.is_empty(), "{second:?}");
    bus.run_for(10 * MILLISECOND);
    assert_eq!(bus.controller.progress(), Progress::Running);
    assert_eq!(bus.cycles_without_command(0x212, from), 3);
}

#[test]
fn each_loop_explains_itself_in_frames_of_its_own() {
    let hold = |millimetres: &str| {
        format!(
            "[controller.pid]\n[[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = {millimetres}\n"
        )
    };
    let mut bus = bus_with([&hold("10.0"), &hold("12.0")]);
    bus.run_until_running();
    bus.run_for(25 * MILLISECOND);
    let micrometres = [0x181, 0x1A1].map(|id| {
        let frames = bus.frames(id, Duration::ZERO);
        let frame = frames.last().unwrap();
        let [a, b, c, d, ..] = frame.buffer();
        i32::from_le_bytes([a, b, c, d])
    });
    assert_eq!(micrometres, [10_000, 12_000]);
}
