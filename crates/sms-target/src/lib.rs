//! Target worlds in which a plan is executed; the planner never reads them.
