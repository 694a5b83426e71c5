//! The nodes of a bench by name: the data sheet of each, and its frames.

use canopen::object_dictionary::Preset;
use dbc::loops::truth_presets;
use dbc::{DISTURBANCE_EDS, DRIVE_EDS, Database, data_sheets};
use scenario::node::Node;
use scenario::port::Unit;
use scenario::wiring::IoOutput;

use crate::data_sheet::{DataSheet, DataSheetError, rig_data_sheets};
use crate::plan::{ControlLoop, Plan, each_once};

/// Returns the nodes of a plan in the order of the node-IDs, each with the text of its EDS.
pub fn node_sheets(plan: &Plan) -> Vec<(Node, String)> {
    let mut sheets = Vec::from_iter(plan.loops.iter().flat_map(loop_sheets));
    let drives = plan.loops.iter().map(|one| one.nodes.drive.id);
    let io_nodes = plan.loops.iter().flat_map(|one| &one.nodes.io);
    let servers = each_once(drives.chain(io_nodes.map(|node| node.id)));
    let eds = data_sheets::controller_sheet(&servers);
    sheets.push(sheet(plan.controller(), &eds, &[], None));
    sheets.sort_by_key(|(node, _)| node.id);
    sheets.dedup_by_key(|(node, _)| node.id);
    sheets
}

fn sheet(node: &Node, eds: &str, presets: &[Preset], unit: Option<&str>) -> (Node, String) {
    let text = data_sheets::node_sheet(eds, (&node.name, node.id), presets, unit);
    (node.clone(), text)
}

fn loop_sheets(one: &ControlLoop) -> Vec<(Node, String)> {
    let drive = &one.nodes.drive;
    let drive_sheet = match &one.real_drive {
        // The maker's EDS, which knows nothing of this rig.
        Some(rig) => (drive.clone(), rig.eds.clone()),
        None => {
            let wiring = &one.trial.wiring;
            let measured = Some(&wiring.sensor.measurand.unit);
            let unit = measured.filter(|unit| **unit != Unit::Millimetres);
            let truth = truth_presets(wiring.loop_number(), wiring.truth_every_cycles());
            let presets = Vec::from_iter(one.trial.presets().into_iter().chain(truth));
            sheet(drive, DRIVE_EDS, &presets, unit.map(Unit::word))
        }
    };
    let io_sheets = one.nodes.io.iter().map(|io| {
        let outputs = one.io_outputs(io).iter().map(IoOutput::in_sheet);
        let eds = data_sheets::with_outputs(DISTURBANCE_EDS, outputs);
        let watch = data_sheets::io_watch(one.nodes.controller.id);
        sheet(io, &eds, &[watch], None)
    });
    [drive_sheet].into_iter().chain(io_sheets).collect()
}

/// Nodes of a bench as tools know them.
#[derive(Clone, Debug)]
pub struct NamedNodes {
    /// Data sheets of the nodes.
    pub sheets: Vec<DataSheet>,
    /// Meaning of their frames, each message by the name of its node.
    pub database: Database,
}

impl NamedNodes {
    /// Returns the nodes of the shipped rig.
    pub fn shipped() -> Self {
        Self {
            sheets: rig_data_sheets(),
            database: Database::shipped().clone(),
        }
    }

    /// Returns the nodes of a plan.
    ///
    /// # Errors
    /// An EDS is wrong.
    pub fn of(plan: &Plan) -> Result<Self, DataSheetError> {
        let sheets = node_sheets(plan).into_iter();
        let parsed = sheets.map(|(Node { name, id, .. }, eds)| {
            DataSheet::parse(format!("{name}.eds"), &name, id, &eds)
        });
        Ok(Self {
            sheets: parsed.collect::<Result<_, _>>()?,
            database: Database::clone(plan.database()),
        })
    }
}
