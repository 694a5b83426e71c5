//! The identifiers of frames beside those that CiA 301 gives each node (its predefined connection set, 7.3.5).

use std::collections::BTreeSet;

use canopen::cob_id::is_restricted;

use crate::rig::nodes::{CONTROLLER_NODE_ID, NodeKind, Rig};

/// TPDOs in which a controller publishes the terms of the law of a loop.
const TERMS: usize = 4;
/// COB-IDs of the controller's first TPDOs, which are those of the terms of its first loop: less its node-ID.
const TPDO1: u16 = 0x180;
const TPDO_DISTANCE: u16 = 0x100;
/// The TPDOs of the controller's loops are these apart; four of them before those of the next function.
const LOOP_OFFSET: u16 = 0x20;
const LOOPS_IN_A_FUNCTION: u16 = 4;
const FUNCTION_OFFSET: u16 = 0x80;
/// Less the node-ID of a drive: its second SDO channel, and the report of an emulated plant about itself.
const SDO2_REQUEST: u16 = 0x680;
const SDO2_ANSWER: u16 = 0x6C0;
const TRUTH: u16 = 0x6A0;
/// Less the node-ID of the controller, whose RPDO2 to RPDO4 they would be: the set-points of the first loops. Its RPDO1 would come
/// before the commands.
const SET_POINTS: [u16; 3] = [0x300, 0x400, 0x500];
/// Emergencies and the PDOs of a node, less its node-ID.
const PREDEFINED: [u16; 9] = [
    0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500,
];
/// SYNC and TIME.
const OF_ALL: [u16; 2] = [0x080, 0x100];
/// What has no place of its own begins below this.
const BELOW: u16 = 0x6E0;

/// The identifiers of a drive, and of the terms of the law of its loop, beside those that CiA 301 gives each node.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Identifiers {
    /// Request and answer of the second SDO channel of an emulated drive (0x1201).
    pub second_sdo: [u16; 2],
    /// The report of an emulated plant about itself.
    pub truth: u16,
    /// The terms of the law.
    pub terms: [u16; TERMS],
    /// The set-point that the bench sends.
    pub set_point: u16,
}

impl Default for Identifiers {
    /// Those of the shipped rig.
    fn default() -> Self {
        Self::new(CONTROLLER_NODE_ID, 0x10, 0)
    }
}

impl Identifiers {
    /// As they are where they are free: of a drive with this node-ID in a loop with this number, led by this controller.
    #[must_use]
    pub const fn new(controller: u8, drive: u8, number: u8) -> Self {
        let number = number as u16;
        let offset = LOOP_OFFSET * (number % LOOPS_IN_A_FUNCTION)
            + FUNCTION_OFFSET * (number / LOOPS_IN_A_FUNCTION);
        let first = TPDO1 + controller as u16 + offset;
        let drive = drive as u16;
        Self {
            second_sdo: [SDO2_REQUEST + drive, SDO2_ANSWER + drive],
            truth: TRUTH + drive,
            terms: [
                first,
                first + TPDO_DISTANCE,
                first + 2 * TPDO_DISTANCE,
                first + 3 * TPDO_DISTANCE,
            ],
            set_point: match number {
                0..3 => SET_POINTS[number as usize] + controller as u16,
                _ => 0,
            },
        }
    }

    /// Those of nodes.
    fn of_nodes_mut(&mut self) -> [&mut u16; 3 + TERMS] {
        let Self {
            second_sdo: [request, answer],
            truth,
            terms: [first, second, third, fourth],
            ..
        } = self;
        [request, answer, truth, first, second, third, fourth]
    }
}

impl Rig {
    /// Gives the loops their identifiers: as CiA 301 and canrig have them, and where another node has one of them, the highest that
    /// is free, in the order of node-IDs.
    pub(crate) fn assign_identifiers(&mut self) {
        let controller = self
            .controller()
            .map_or(CONTROLLER_NODE_ID, |(_, node)| node.node_id);
        let drives = self.loops.keys().map(|name| {
            let node = self.node.get(self.drive_of_loop(name));
            node.map_or(0, |node| node.node_id)
        });
        let mut all = Vec::from_iter(
            (0..)
                .zip(drives)
                .map(|(number, drive)| (drive, Identifiers::new(controller, drive, number))),
        );
        let mut taken = BTreeSet::from(OF_ALL);
        let others = self
            .node
            .values()
            .filter(|node| node.kind != NodeKind::Controller);
        for node in others {
            taken.extend(PREDEFINED.map(|function| function + u16::from(node.node_id)));
        }
        let mut homeless: Vec<(u8, &mut u16)> = Vec::new();
        for (drive, identifiers) in &mut all {
            for identifier in identifiers.of_nodes_mut() {
                let is_free = *identifier < BELOW && !is_restricted(*identifier);
                if !is_free || !taken.insert(*identifier) {
                    homeless.push((*drive, identifier));
                }
            }
        }
        homeless.sort_by_key(|(drive, _)| *drive);
        for (_, identifier) in homeless {
            *identifier = take_free(&mut taken);
        }
        // After all others, whom they leave where they are on a bus without set-points.
        for (_, identifiers) in &mut all {
            let wanted = identifiers.set_point;
            if is_restricted(wanted) || !taken.insert(wanted) {
                identifiers.set_point = take_free(&mut taken);
            }
        }
        for (one, (_, identifiers)) in self.loops.values_mut().zip(all) {
            one.identifiers = identifiers;
        }
    }
}

/// Takes the highest identifier that is free; 0 where there is none.
fn take_free(taken: &mut BTreeSet<u16>) -> u16 {
    let is_free = |id: &u16| !is_restricted(*id) && !taken.contains(id);
    let free = (0..BELOW).rev().find(is_free).unwrap_or_default();
    taken.insert(free);
    free
}
