//! The layout with which the viewer opens the recording.
//!
//! It is logged as raw archetypes, since the SDK's typed layout cannot yet link time axes or place legends.

use std::collections::BTreeSet;

use re_sdk::external::re_log_types::BlueprintActivationCommand;
use re_sdk::log::{Chunk, LogMsg};
use re_sdk::{AsComponents, EntityPath, StoreId, StoreKind, Timeline};
use re_sdk_types::blueprint::archetypes::{
    ContainerBlueprint, PanelBlueprint, PlotLegend, TextLogColumns, TimeAxis, TimePanelBlueprint,
    ViewBlueprint, ViewContents, ViewportBlueprint, VisualBounds2D,
};
use re_sdk_types::blueprint::components::{
    AutoLayout, AutoViews, ColumnShare, ContainerKind, Corner2D, IncludedContent, LinkAxis,
    PanelState, PlayState, QueryExpression, RootContainer, RowShare, TextLogColumn, TimelineName,
};
use re_sdk_types::blueprint::datatypes::{self, TextLogColumnKind};
use re_sdk_types::datatypes::{Bool, Float32, Range1D, Range2D, Uuid};

use super::contour::Plane;
use super::output::{Output, begin};
use super::times::RUN_TIME;
use super::{APPLICATION, ReportError, drawing, groups, hysteresis};
use crate::shown_unit;
use plan::{ControlLoop, Plan};

type Result<T> = std::result::Result<T, ReportError>;

/// Page of a loop in the layout.
pub(crate) struct Page<'a> {
    pub(super) plan: &'a Plan,
    pub(super) control_loop: &'a ControlLoop,
    pub(super) groups: BTreeSet<&'a str>,
}

/// Sends the layout: with several loops each has a tab, after the tabs of contours. `play` is the state of the viewer's time at
/// the start.
pub(super) fn send(
    output: &mut dyn Output,
    pages: &[Page<'_>],
    planes: &[Plane],
    play: PlayState,
) -> Result<()> {
    let store = StoreId::new(StoreKind::Blueprint, APPLICATION, "canrig layout");
    output.send_message(begin(store.clone()))?;
    let mut layout = Layout {
        output,
        store: store.clone(),
        folder: "",
        play,
        places: 0,
    };
    layout.build(pages, planes)?;
    let show = BlueprintActivationCommand {
        blueprint_id: store,
        make_active: true,
        make_default: true,
    };
    output.send_message(show.into())
}

/// View or container, and its share of the room.
struct Place {
    id: Uuid,
    path: String,
    share: f32,
}

struct Layout<'a> {
    output: &'a mut dyn Output,
    store: StoreId,
    /// Folder of the loop; empty if there is only one.
    folder: &'a str,
    play: PlayState,
    places: u8,
}

impl<'a> Layout<'a> {
    fn build(&mut self, pages: &'a [Page<'a>], planes: &[Plane]) -> Result<()> {
        let mut tabs = Vec::new();
        for plane in planes {
            tabs.push(self.drawing(&plane.title, &plane.group, plane.bounds, 1.0)?);
        }
        for page in pages {
            self.folder = page.control_loop.name();
            tabs.push(self.page(page)?);
        }
        self.folder = "";
        let root = match <[Place; 1]>::try_from(tabs) {
            Ok([only]) => only,
            Err(tabs) => {
                let loops = self.container(ContainerKind::Tabs, tabs, 2.4)?;
                let verdict = self.view("TextDocument", "Verdict", "verdict", 1.0)?;
                self.container(ContainerKind::Horizontal, vec![loops, verdict], 1.0)?
            }
        };
        self.viewport(&root)
    }

    /// Adds all views of a loop.
    fn page(&mut self, page: &Page<'_>) -> Result<Place> {
        let groups = &page.groups;
        let has = |group| groups.contains(group);
        let quantities = &page.control_loop.trial.wiring.quantities;
        let unit = shown_unit(quantities.feedback.unit.symbol());
        let title = format!("{} ({unit})", quantities.feedback.title());
        let mut left = vec![self.plot(&title, &quantities.feedback.name, 2.2)?];
        if has("error") {
            left.push(self.plot(&format!("Error ({unit})"), "error", 1.2)?);
        }
        let output = &quantities.output;
        let commands = match output.unit.symbol() {
            "" => output.title(),
            symbol => format!("{} ({symbol})", output.title()),
        };
        left.push(self.plot(&commands, &output.name, 1.2)?);
        if has(groups::DISTURBANCE) {
            left.push(self.plot("Disturbance", groups::DISTURBANCE, 0.8)?);
        }
        if has(groups::SLIDING_VARIABLE) {
            let title = "Sliding variable (m/s²)";
            let variable = self.plot(title, groups::SLIDING_VARIABLE, 1.0)?;
            let law = self.plot("Parts of the law (A²)", groups::LAW, 1.0)?;
            left.push(self.container(ContainerKind::Tabs, vec![variable, law], 1.0)?);
        }

        let mut middle = Vec::new();
        for (group, title) in [
            ("temperature", "Temperature (°C)"),
            (groups::MOTOR_SPEED, "Motor speed (rpm)"),
            (groups::SPRING_FORCE, "Spring force (N)"),
            ("martensite_fraction", "Martensite fraction"),
        ] {
            if has(group) && group != quantities.feedback.name {
                middle.push(self.plot(title, group, 1.0)?);
            }
        }
        if has(groups::HYSTERESIS) {
            let title = "Martensite fraction over temperature";
            middle.push(self.drawing(title, groups::HYSTERESIS, hysteresis::BOUNDS, 1.7)?);
        }
        for view in groups::custom_views(page.plan, page.control_loop) {
            if has(view.style.group) {
                middle.push(self.plot(&view.title, view.style.group, 1.0)?);
            }
        }
        let timing = self.plot("Timing (µs)", groups::TIMING, 1.0)?;
        let load = self.plot("Bus load (%)", "bus", 0.8)?;
        let mut right = Vec::new();
        if let Some(bounds) = drawing::bounds(&page.control_loop.trial) {
            right.push(self.drawing("Rig", "rig", bounds, 2.0)?);
        }
        right.extend([timing, load, self.event_log("events", 1.1)?]);
        if self.folder.is_empty() {
            right.push(self.view("TextDocument", "Verdict", "verdict", 1.4)?);
        }

        let mut columns = vec![self.container(ContainerKind::Vertical, left, 3.0)?];
        if !middle.is_empty() {
            columns.push(self.container(ContainerKind::Vertical, middle, 2.2)?);
        }
        columns.push(self.container(ContainerKind::Vertical, right, 2.2)?);
        self.container(ContainerKind::Horizontal, columns, 1.0)
    }

    /// Adds a plot of one group over time; the time axes of all plots move together.
    fn plot(&mut self, title: &str, group: &str, share: f32) -> Result<Place> {
        let place = self.view("TimeSeries", title, group, share)?;
        let legend = PlotLegend::new().with_corner(Corner2D::LeftTop);
        self.log(&format!("{}/PlotLegend", place.path), &legend)?;
        let axis = TimeAxis::new().with_link(LinkAxis::LinkToGlobal);
        self.log(&format!("{}/TimeAxis", place.path), &axis)?;
        Ok(place)
    }

    /// Adds a list of events with level and text. The path is left out, since it would be the same in each row.
    fn event_log(&mut self, group: &str, share: f32) -> Result<Place> {
        let place = self.view("TextLog", "Events", group, share)?;
        let columns = [TextLogColumnKind::LogLevel, TextLogColumnKind::Body].map(|kind| {
            TextLogColumn(datatypes::TextLogColumn {
                visible: Bool(true),
                kind,
            })
        });
        let columns = TextLogColumns::new().with_text_log_columns(columns);
        self.log(&format!("{}/TextLogColumns", place.path), &columns)?;
        Ok(place)
    }

    /// Adds a drawing in the plane. The bounds are the least and the largest coordinate, across and down.
    fn drawing(
        &mut self,
        title: &str,
        group: &str,
        bounds: [[f64; 2]; 2],
        share: f32,
    ) -> Result<Place> {
        let place = self.view("2D", title, group, share)?;
        let [x_range, y_range] = bounds.map(Range1D);
        let bounds = VisualBounds2D::new(Range2D { x_range, y_range });
        self.log(&format!("{}/VisualBounds2D", place.path), &bounds)?;
        Ok(place)
    }

    fn view(&mut self, class: &str, title: &str, group: &str, share: f32) -> Result<Place> {
        let id = self.next_id();
        let path = format!("view/{id}");
        let origin = EntityPath::from(self.folder).join(&group.into());
        let view = ViewBlueprint::new(class)
            .with_display_name(title)
            .with_space_origin(origin.to_string());
        self.log(&path, &view)?;
        // Without contents the viewer shows nothing.
        let contents = ViewContents::new([QueryExpression("$origin/**".into())]);
        self.log(&format!("{path}/ViewContents"), &contents)?;
        Ok(Place { id, path, share })
    }

    fn container(
        &mut self,
        kind: ContainerKind,
        contents: Vec<Place>,
        share: f32,
    ) -> Result<Place> {
        let id = self.next_id();
        let path = format!("container/{id}");
        let included = contents
            .iter()
            .map(|place| IncludedContent(place.path.as_str().into()));
        let shares = contents.iter().map(|place| Float32(place.share));
        let container = ContainerBlueprint::new(kind).with_contents(included);
        let container = match self.folder {
            "" => container,
            name => container.with_display_name(name),
        };
        let container = match kind {
            ContainerKind::Horizontal => container.with_col_shares(shares.map(ColumnShare)),
            ContainerKind::Vertical => container.with_row_shares(shares.map(RowShare)),
            ContainerKind::Tabs | ContainerKind::Grid => container,
        };
        self.log(&path, &container)?;
        Ok(Place { id, path, share })
    }

    fn viewport(&mut self, root: &Place) -> Result<()> {
        let viewport = ViewportBlueprint::new()
            .with_root_container(RootContainer(root.id))
            .with_auto_layout(AutoLayout(Bool(false)))
            .with_auto_views(AutoViews(Bool(false)));
        self.log("viewport", &viewport)?;
        let collapsed = PanelBlueprint::new().with_state(PanelState::Collapsed);
        self.log("blueprint_panel", &collapsed)?;
        self.log("selection_panel", &collapsed)?;
        let time_panel = TimePanelBlueprint::new()
            .with_state(PanelState::Collapsed)
            .with_timeline(TimelineName(RUN_TIME.into()))
            .with_play_state(self.play);
        self.log("time_panel", &time_panel)
    }

    fn log(&mut self, path: &str, what: &dyn AsComponents) -> Result<()> {
        let time = [(Timeline::new_sequence("blueprint"), 0)];
        let chunk = Chunk::builder(path).with_archetype_auto_row(time, what);
        let rows = chunk.build()?.to_arrow_msg()?;
        let message = LogMsg::ArrowMsg(self.store.clone(), rows);
        self.output.send_message(message)
    }

    /// Returns a new id; any distinct ids will do.
    fn next_id(&mut self) -> Uuid {
        self.places += 1;
        let mut bytes = *b"canrig layout 00";
        bytes[15] = self.places;
        Uuid { bytes }
    }
}
