//! Identifiers of frames other than those that CiA 301 gives each node (its predefined connection set, 7.3.5).

use std::collections::BTreeSet;

use canopen::cob_id::is_restricted;

use crate::node::Profile;
use crate::rig::nodes::{CONTROLLER_NODE_ID, Rig};

/// Number of TPDOs in which a controller publishes the terms of the law of a loop.
const TERMS: usize = 4;
/// COB-ID of the controller's TPDO1 without its node-ID: the first terms of its first loop.
const TPDO1: u16 = 0x180;
const TPDO_DISTANCE: u16 = 0x100;
/// Distance between the TPDOs of two loops; four loops fit before the identifiers of the next function.
const LOOP_OFFSET: u16 = 0x20;
const LOOPS_IN_A_FUNCTION: u16 = 4;
const FUNCTION_OFFSET: u16 = 0x80;
/// Identifiers of a drive without its node-ID: its second SDO channel, and the report of an emulated plant about itself.
const SDO2_REQUEST: u16 = 0x680;
const SDO2_ANSWER: u16 = 0x6C0;
const TRUTH: u16 = 0x6A0;
/// Identifiers of the first loops' set-points without the node-ID of the controller, whose RPDO2 to RPDO4 they would be. Its
/// RPDO1 would come before the commands.
const SET_POINTS: [u16; 3] = [0x300, 0x400, 0x500];
/// Identifiers of emergencies and of the PDOs of a node, without its node-ID.
const PREDEFINED: [u16; 9] = [
    0x080, 0x180, 0x200, 0x280, 0x300, 0x380, 0x400, 0x480, 0x500,
];
/// Identifiers of SYNC and TIME.
const SHARED: [u16; 2] = [0x080, 0x100];
/// Upper end of the identifiers for frames without a fixed place: the search goes downwards from here.
const BELOW: u16 = 0x6E0;

/// Identifiers of a drive, and of the terms of its loop's law, other than those that CiA 301 gives each node.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct Identifiers {
    /// Request and answer of the second SDO channel of an emulated drive (0x1201).
    pub second_sdo: [u16; 2],
    /// Report of an emulated plant about itself.
    pub truth: u16,
    /// Terms of the law.
    pub terms: [u16; TERMS],
    /// Set-point that the bench sends.
    pub set_point: u16,
}

impl Default for Identifiers {
    /// Returns the identifiers of the shipped rig.
    fn default() -> Self {
        Self::new(CONTROLLER_NODE_ID, 0x10, 0)
    }
}

impl Identifiers {
    /// Returns the preferred identifiers of a drive with this node-ID, in a loop with this number, led by this controller.
    pub fn new(controller: u8, drive: u8, number: u8) -> Self {
        let number = u16::from(number);
        let offset = LOOP_OFFSET * (number % LOOPS_IN_A_FUNCTION)
            + FUNCTION_OFFSET * (number / LOOPS_IN_A_FUNCTION);
        let first = TPDO1 + u16::from(controller) + offset;
        let drive = u16::from(drive);
        Self {
            second_sdo: [SDO2_REQUEST + drive, SDO2_ANSWER + drive],
            truth: TRUTH + drive,
            terms: [0, 1, 2, 3].map(|place| first + place * TPDO_DISTANCE),
            set_point: SET_POINTS
                .get(usize::from(number))
                .map_or(0, |set_point| set_point + u16::from(controller)),
        }
    }

    /// Returns the identifiers that nodes send and receive, without the set-point.
    fn node_identifiers_mut(&mut self) -> impl Iterator<Item = &mut u16> {
        let second_sdo = self.second_sdo.iter_mut();
        second_sdo.chain([&mut self.truth]).chain(&mut self.terms)
    }
}

impl Rig {
    /// Gives the loops their identifiers: the preferred one of CiA 301 or canrig, and if another node has it, the highest free
    /// one, in the order of node-IDs.
    pub(crate) fn assign_identifiers(&mut self) {
        let controller = self
            .controller()
            .map_or(CONTROLLER_NODE_ID, |(_, node)| node.node_id);
        let loops = (0..).zip(self.loops.keys()).map(|(number, name)| {
            let node = self.node.get(self.drive_of_loop(name));
            let drive = node.map_or(0, |node| node.node_id);
            (drive, Identifiers::new(controller, drive, number))
        });
        let mut all = Vec::from_iter(loops);
        let mut taken = BTreeSet::from(SHARED);
        let nodes = self.node.values();
        for node in nodes.filter(|node| node.kind != Profile::Manager) {
            taken.extend(PREDEFINED.map(|function| function + u16::from(node.node_id)));
        }
        let mut homeless: Vec<(u8, &mut u16)> = Vec::new();
        for (drive, identifiers) in &mut all {
            for identifier in identifiers.node_identifiers_mut() {
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
        // Set-points come last: then all other identifiers are the same on a bus without set-points.
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

/// Takes the highest free identifier; 0 if there is none.
fn take_free(taken: &mut BTreeSet<u16>) -> u16 {
    let is_free = |id: &u16| !is_restricted(*id) && !taken.contains(id);
    let free = (0..BELOW).rev().find(is_free).unwrap_or_default();
    taken.insert(free);
    free
}
