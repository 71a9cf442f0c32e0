//! Metrics against truth, figures and the report page.
