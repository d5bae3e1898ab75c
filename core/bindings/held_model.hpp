// SPDX-FileCopyrightText: 2026 The quadpi authors
// SPDX-License-Identifier: Apache-2.0
// Fitted models and monitors as Python has them: objects that hold their arrays as long as they live.
#pragma once

#include "bindings/records.hpp"
#include "quadpi/models/evaluation.hpp"

namespace quadpi {

// A fitted model, taken once: to hold its arrays anew for each sample would cost more than its evaluation.
class HeldModel {
public:
    explicit HeldModel(nanobind::object its_arrays) : arrays(std::move(its_arrays)) {}
    virtual ~HeldModel() = default;

    virtual Evaluator& evaluator() = 0;

    nanobind::object arrays;
};

}  // namespace quadpi
