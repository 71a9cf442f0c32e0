//! Integration tests.

mod closed_form;
