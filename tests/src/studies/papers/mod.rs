//! Figures of the papers on probes (\[Sukys2014\], \[Luo2022\]) made again with captured light, for `tests/studies/papers.md`.

mod clouds;
mod lattices;
mod scene;

use anyhow::Result;

pub use scene::{CapturedScene, Reading};

/// A table in Markdown.
pub struct Table {
    title: &'static str,
    text: &'static str,
    head: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

impl Table {
    fn new(title: &'static str, text: &'static str, head: &[&'static str]) -> Self {
        Self { title, text, head: head.to_vec(), rows: Vec::new() }
    }

    fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// The heading, the text and the rows.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let head: Vec<String> = self.head.iter().map(|&cell| cell.to_owned()).collect();
        let rows: String = self.rows.iter().map(|cells| line(cells)).collect();
        let Self { title, text, .. } = self;
        format!("## {title}\n\n{text}\n\n{}|{}\n{rows}", line(&head), "---|".repeat(head.len()))
    }
}

/// Makes a table.
type Make = fn() -> Result<Table>;

/// All tables by name, in order.
pub const TABLES: [(&str, Make); 9] = [
    ("rounds", clouds::rounds),
    ("seconds", clouds::seconds),
    ("directions", clouds::directions),
    ("tessellations", clouds::tessellations),
    ("carried", clouds::carried),
    ("walls", lattices::walls),
    ("outer_faces", lattices::outer_faces),
    ("costs", lattices::costs),
    ("seams", lattices::seams),
];

/// A share in percent.
fn percent(share: f64) -> String {
    if share == 0.0 { "0".to_owned() } else { format!("{:.2} %", 100.0 * share) }
}
