//! `canrig schema`: the JSON Schema of scenario and rig files, for editors.

use clap::Args;

use runner::console::print;
use runner::exit::Exit;

/// Arguments of `schema`.
#[derive(Args, Debug)]
pub(crate) struct SchemaArgs {
    /// Print the schema of rig files instead
    #[arg(long)]
    pub rig: bool,
}

/// Prints the schema.
pub(crate) fn schema(args: &SchemaArgs) -> Exit {
    print(&if args.rig {
        scenario::schema::rig_json_schema()
    } else {
        scenario::schema::json_schema()
    });
    Exit::Pass
}
