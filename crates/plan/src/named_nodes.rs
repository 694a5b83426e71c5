//! The nodes of a bench by name: the data sheet of each, and its frames.

use canopen::ObjectDictionary;
use dbc::data_sheets::sheet;
use dbc::loops::truth_presets;
use dbc::node_objects::PlantSignals;
use dbc::{CONTROLLER_EDS, DISTURBANCE_EDS, DRIVE_EDS, Database, Message, node_objects};
use scenario::node::Node;
use scenario::wiring::{IoOutput, device_name};

use crate::data_sheet::{DataSheet, DataSheetError, rig_data_sheets};
use crate::plan::{ControlLoop, Plan};

/// A node of a plan with its objects.
struct NodeObjects<'a> {
    node: &'a Node,
    objects: ObjectDictionary,
    /// Shipped EDS, whose place the objects take.
    shipped: &'static str,
    /// EDS of the maker of a real drive, which knows nothing of this rig.
    makers: Option<&'a str>,
}

/// Returns the nodes of a plan in the order of the node-IDs.
fn nodes(plan: &Plan) -> Vec<NodeObjects<'_>> {
    let mut nodes = Vec::new();
    let (mut drives, mut io_nodes, mut terms) = (Vec::new(), Vec::new(), Vec::new());
    for one in &plan.loops {
        nodes.push(drive(plan, one));
        drives.push(one.drive().id());
        let identifiers = one.trial.wiring.identifiers.terms;
        terms.push((one.terms(plan.database()).cloned().collect(), identifiers));
    }
    let node = plan.controller();
    let wired = plan.loops.first().map(|one| &one.trial.wiring.shared.rig);
    let rig = wired.unwrap_or(&plan.shared.rig.name);
    let named = |objects, node: &Node| {
        let name = device_name(rig, &node.name);
        node_objects::with_device_name(objects, name)
    };
    for (io, outputs) in plan.io_outputs() {
        let io = &plan.nodes[*io];
        let outputs = outputs.iter().map(IoOutput::in_sheet);
        let objects = node_objects::io(io.id(), outputs, node.id());
        let objects = named(objects, io);
        nodes.push(NodeObjects {
            node: io,
            objects,
            shipped: DISTURBANCE_EDS,
            makers: None,
        });
        io_nodes.push(io.id());
    }
    let objects = node_objects::controller(node.id(), &terms, &drives, &io_nodes);
    let objects = named(objects, node);
    nodes.push(NodeObjects {
        node,
        objects,
        shipped: CONTROLLER_EDS,
        makers: None,
    });
    nodes.sort_by_key(|one| one.node.id());
    nodes.dedup_by_key(|one| one.node.id());
    nodes
}

fn drive<'a>(plan: &Plan, one: &'a ControlLoop) -> NodeObjects<'a> {
    let (node, wiring) = (one.drive(), &one.trial.wiring);
    if let Some(real) = &one.real_drive {
        return NodeObjects {
            node,
            objects: real.layout.dictionary.clone(),
            shipped: DRIVE_EDS,
            makers: Some(&real.eds),
        };
    }
    let pace = truth_presets(wiring.loop_number(), wiring.truth_every_cycles());
    let presets = one.trial.presets().into_iter().chain(pace);
    let truth = PlantSignals::of(plan.database(), &node.name);
    let objects = node_objects::drive(node.id(), truth, presets);
    let objects = node_objects::with_device_name(objects, wiring.shared.device_name(&node.name));
    NodeObjects {
        node,
        objects,
        shipped: DRIVE_EDS,
        makers: None,
    }
}

/// Returns the nodes of a plan in the order of the node-IDs, each with the text of its EDS.
pub fn node_sheets(plan: &Plan) -> Vec<(Node, String)> {
    let sheets = nodes(plan).into_iter().map(|one| {
        let node = one.node;
        let is_its = |message: &&Message| {
            let mut receivers = message.signals.iter().flat_map(|signal| &signal.receivers);
            message.sender.as_ref() == Some(&node.name) || receivers.any(|name| *name == node.name)
        };
        let messages = plan.database().messages().iter().filter(is_its);
        let ours = || sheet(one.shipped, (&node.name, node.id()), &one.objects, messages);
        (node.clone(), one.makers.map_or_else(ours, str::to_owned))
    });
    sheets.collect()
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

    /// Returns the nodes of a run with the sheets that it has written of them.
    ///
    /// # Errors
    /// A text is not an EDS.
    pub fn of_run(plan: &Plan, sheets: &[(Node, String)]) -> Result<Self, DataSheetError> {
        let parse = |(node, text): &(Node, String)| {
            DataSheet::parse(format!("{}.eds", node.name), &node.name, node.id(), text)
        };
        Ok(Self {
            sheets: sheets.iter().map(parse).collect::<Result<_, _>>()?,
            database: Database::clone(plan.database()),
        })
    }

    /// Returns the nodes of a plan.
    pub fn of(plan: &Plan) -> Self {
        let sheets = nodes(plan).into_iter().map(|one| DataSheet {
            name: format!("{}.eds", one.node.name),
            node_name: one.node.name.clone(),
            node_id: one.node.id(),
            dictionary: one.objects,
        });
        Self {
            sheets: sheets.collect(),
            database: Database::clone(plan.database()),
        }
    }
}
