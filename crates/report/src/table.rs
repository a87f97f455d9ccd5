//! Tables for people, spreadsheets, papers and pages.

use maud::{Markup, html};
use std::fmt::Write as _;

/// Digits the smallest number of a column is shown with.
const SIGNIFICANT: i32 = 4;

/// Share of the largest number of a column below which a number is shown as it comes out.
const NEGLIGIBLE: f64 = 1e-4;

/// Most decimals shown; smaller numbers call for another unit.
const MOST_DECIMALS: i32 = 6;

/// Which numbers of a column are good.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Best {
    /// Small ones.
    Lowest,
    /// Large ones.
    Highest,
    /// Numbers that are no matter of good or bad.
    Neither,
}

/// One value; what is missing is shown as a dash.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Words.
    Text(String),
    /// A whole number.
    Count(usize),
    /// A measured number.
    Number(f64),
    /// Nothing known.
    Missing,
}

impl From<Option<f64>> for Cell {
    fn from(number: Option<f64>) -> Self {
        number.map_or(Self::Missing, Self::Number)
    }
}

/// A title, named columns with their units, and rows. The best number of a column is marked.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    title: String,
    columns: Vec<(String, Best)>,
    rows: Vec<Vec<Cell>>,
    /// Rows at the end that are shown for comparison and never marked.
    aside: usize,
}

impl Table {
    /// An empty table.
    pub fn new(title: impl Into<String>, columns: &[(&str, Best)]) -> Self {
        let columns = columns.iter().map(|(head, best)| ((*head).to_owned(), *best)).collect();
        Self { title: title.into(), columns, rows: Vec::new(), aside: 0 }
    }

    /// Adds a row with one cell per column.
    pub fn push(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
    }

    /// Adds a row for comparison, such as a trivial answer; only such rows may follow it.
    pub fn push_aside(&mut self, row: Vec<Cell>) {
        self.rows.push(row);
        self.aside += 1;
    }

    /// For a page: a caption, heads with scope, the best in bold, rows for comparison in a body of their own.
    pub fn html(&self) -> Markup {
        let cells = self.rendered("*", "");
        let competing = self.rows.len() - self.aside;
        let body = |rows: &[Vec<String>], class: &str| {
            html! {
                tbody class=(class) {
                    @for row in rows {
                        tr {
                            @for (column, cell) in row.iter().enumerate() {
                                @if column == 0 {
                                    th scope="row" { (cell) }
                                } @else if let Some(best) = cell.strip_suffix('*') {
                                    td { strong { (best) } span.hidden { " (best)" } }
                                } @else {
                                    td { (cell) }
                                }
                            }
                        }
                    }
                }
            }
        };
        html! {
            div.scroll tabindex="0" role="region" aria-label=(self.title) {
                table {
                    caption { (self.title) }
                    thead { tr { @for (head, _) in &self.columns { th scope="col" { (head) } } } }
                    (body(&cells[..competing], "methods"))
                    @if self.aside > 0 { (body(&cells[competing..], "aside")) }
                }
            }
        }
    }

    /// For a terminal: columns aligned, the best marked with a star.
    pub fn text(&self) -> String {
        let cells = self.rendered("*", " ");
        let width = |column: usize| {
            let widths = cells.iter().map(|row| row[column].chars().count());
            widths.chain([self.columns[column].0.chars().count()]).max().unwrap_or_default()
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let line = |row: &[String]| {
            let padded = row.iter().zip(&widths).enumerate().map(|(column, (cell, width))| {
                if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        let head: Vec<String> = self.columns.iter().map(|(head, _)| head.clone()).collect();
        let rule = "-".repeat(widths.iter().sum::<usize>() + 2 * widths.len().saturating_sub(1));
        let mut text = format!("{}\n{}\n{rule}\n", self.title, line(&head));
        for row in &cells {
            text.push_str(&line(row));
            text.push('\n');
        }
        text
    }

    /// Comma-separated, every digit, under a comment line with the title.
    pub fn csv(&self) -> String {
        let quoted = |text: &str| {
            if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
        };
        let head: Vec<String> = self.columns.iter().map(|(head, _)| quoted(head)).collect();
        let mut text = format!("# {}\n{}\n", self.title, head.join(","));
        for row in &self.rows {
            let cells = row.iter().map(|cell| match cell {
                Cell::Text(cell) => quoted(cell),
                Cell::Count(count) => count.to_string(),
                Cell::Number(number) => number.to_string(),
                Cell::Missing => String::new(),
            });
            text.push_str(&cells.collect::<Vec<_>>().join(","));
            text.push('\n');
        }
        text
    }

    /// A `tabular`, the best in bold.
    pub fn latex(&self) -> String {
        let escaped = |text: &str| text.replace('%', r"\%").replace('_', r"\_").replace('#', r"\#");
        let head: Vec<String> = self.columns.iter().map(|(head, _)| escaped(head)).collect();
        let align = format!("l{}", "r".repeat(self.columns.len().saturating_sub(1)));
        let mut text = format!(
            "% {}\n\\begin{{tabular}}{{{align}}}\n\\toprule\n{} \\\\\n\\midrule\n",
            self.title,
            head.join(" & ")
        );
        for row in self.rendered("}", "") {
            let bold = |cell: &String| {
                cell.strip_suffix('}').map_or_else(|| escaped(cell), |best| format!("\\textbf{{{best}}}"))
            };
            // Writing to a String cannot fail.
            writeln!(text, "{} \\\\", row.iter().map(bold).collect::<Vec<_>>().join(" & ")).ok();
        }
        text + "\\bottomrule\n\\end{tabular}\n"
    }

    /// All cells as text; in columns with a best value that one ends in `best` and the others in `other`.
    fn rendered(&self, best: &str, other: &str) -> Vec<Vec<String>> {
        let mut rows: Vec<Vec<String>> = self.rows.iter().map(|_| Vec::new()).collect();
        for (column, (_, direction)) in self.columns.iter().enumerate() {
            let (decimals, winner) = (self.decimals(column), self.winner(column, *direction));
            for (index, row) in rows.iter_mut().enumerate() {
                let cell = match self.rows[index].get(column) {
                    Some(Cell::Text(text)) => text.clone(),
                    Some(Cell::Count(count)) => count.to_string(),
                    Some(Cell::Number(number)) => format!("{number:.decimals$}"),
                    Some(Cell::Missing) | None => "-".to_owned(),
                };
                let mark = if *direction == Best::Neither {
                    ""
                } else if winner == Some(index) {
                    best
                } else {
                    other
                };
                row.push(cell + mark);
            }
        }
        rows
    }

    fn numbers(&self, column: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.rows.iter().enumerate().filter_map(move |(index, row)| match row.get(column) {
            Some(Cell::Number(number)) if number.is_finite() => Some((index, *number)),
            _ => None,
        })
    }

    /// Decimals that show the smallest number of a column with four digits; what is nothing beside the largest does not
    /// count.
    fn decimals(&self, column: usize) -> usize {
        let sizes = || self.numbers(column).map(|(_, number)| number.abs());
        let largest = sizes().fold(0.0, f64::max);
        let smallest = sizes().filter(|size| *size > NEGLIGIBLE * largest).fold(largest, f64::min);
        let magnitude = if smallest > 0.0 { smallest.log10().floor() as i32 } else { 0 };
        (SIGNIFICANT - 1 - magnitude).clamp(0, MOST_DECIMALS) as usize
    }

    fn winner(&self, column: usize, direction: Best) -> Option<usize> {
        let ordered = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
        let competing = self.rows.len() - self.aside;
        let numbers = self.numbers(column).filter(|(index, _)| *index < competing);
        match direction {
            Best::Lowest => numbers.min_by(ordered).map(|(index, _)| index),
            // The first of equals, as for the lowest.
            Best::Highest => numbers.min_by(|a, b| ordered(b, a)).map(|(index, _)| index),
            Best::Neither => None,
        }
    }
}

/// Metres or, where a length is below one metre, millimetres: name of the unit and factor.
pub fn length_unit(length_m: f64) -> (&'static str, f64) {
    if length_m < 1.0 { ("mm", 1e3) } else { ("m", 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table =
            Table::new("Errors", &[("answer", Best::Neither), ("ATE [m]", Best::Lowest), ("share [%]", Best::Highest)]);
        table.push(vec![Cell::Text("estimate".into()), Cell::Number(1.25), Cell::Number(99.0)]);
        table.push(vec![Cell::Text("zero".into()), Cell::Number(12.5), Cell::Missing]);
        table
    }

    #[test]
    fn columns_are_aligned_and_the_best_is_marked() {
        let expected = [
            "Errors",
            "answer    ATE [m]  share [%]",
            "----------------------------",
            "estimate   1.250*     99.00*",
            "zero      12.500          -",
        ];
        let text = table().text();
        let trimmed: Vec<&str> = text.lines().map(str::trim_end).collect();
        assert_eq!(trimmed, expected);
    }

    #[test]
    fn csv_keeps_every_digit_and_latex_escapes() {
        assert_eq!(table().csv(), "# Errors\nanswer,ATE [m],share [%]\nestimate,1.25,99\nzero,12.5,\n");
        let latex = table().latex();
        assert!(latex.contains(r"share [\%]") && latex.contains(r"\textbf{1.250} & \textbf{99.00}"), "{latex}");
    }
}
