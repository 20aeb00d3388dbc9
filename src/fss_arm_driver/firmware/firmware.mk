# How the firmware of a board is built. Who includes this says:
#   HERE      its folder                 FOLDERS   all folders like it that it takes files from
#   PROGRAMS  of host/, made by `all`    PIPE      the one that an emulator runs, too
#   CORE      files of the core          HOST      files that all programs need
# The core keeps to C++11, as Arduino's own compiler for the Due is GCC 4.8.

# At a fixed address: where kernels choose it from 32 bits, it may hit what the sanitizer needs.
SANITIZERS := -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer \
  -fno-pie -no-pie
# No multiply-add in one rounding, where a processor has it: paths are the same everywhere.
COMMON := -ffp-contract=off -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion -Wundef -Werror \
  $(addprefix -I,$(wildcard $(FOLDERS:=/core)))
CXXFLAGS := -O1 -g -MMD -MP $(addprefix -I,$(wildcard $(FOLDERS:=/host))) $(COMMON) $(SANITIZERS)
PROCESS := $(firstword $(wildcard $(FOLDERS:=/host/process.cpp)))
MAKEFILES := $(wildcard $(FOLDERS:=/Makefile) $(FOLDERS:=/firmware.mk))

all: $(addprefix $(BUILD)/,$(PROGRAMS))
.PHONY: all
.DELETE_ON_ERROR:

OBJECTS := $(addprefix $(BUILD)/core/,$(notdir $(CORE:.cpp=.o))) \
  $(addprefix $(BUILD)/host/,$(notdir $(HOST:.cpp=.o) $(PROCESS:.cpp=.o)))

$(addprefix $(BUILD)/,$(PROGRAMS)): $(BUILD)/%: $(BUILD)/host/%.o $(OBJECTS)
	$(CXX) $(SANITIZERS) $^ -o $@

vpath %.cpp $(wildcard $(FOLDERS:=/core) $(FOLDERS:=/host))

$(BUILD)/core/%.o: %.cpp $(MAKEFILES)
	@mkdir -p $(@D)
	$(CXX) -std=c++11 $(CXXFLAGS) -fno-exceptions -fno-rtti -c $< -o $@

$(BUILD)/host/%.o: %.cpp $(MAKEFILES)
	@mkdir -p $(@D)
	$(CXX) -std=c++17 $(CXXFLAGS) -c $< -o $@

-include $(wildcard $(BUILD)/core/*.d $(BUILD)/host/*.d)

# --- Cortex-M3 ----------------------------------------------------------------------------------
# `make cortex-m3`, with Debian's arm-none-eabi toolchain:
#   due.elf        the core and the sketch linked for the Due, to tell their size. What they call
#                  of Arduino's is left out
#   PIPE_m3.elf    for an emulated Cortex-M3 with semihosting

ARM := arm-none-eabi-
ARM_FLAGS := -mcpu=cortex-m3 -mthumb -Os $(COMMON)
DUE_FLAGS := -std=gnu++11 -fno-exceptions -fno-rtti -fno-threadsafe-statics -ffunction-sections -fdata-sections \
  -I$(HERE)/due -I$(BUILD)/due $(addprefix -I,$(wildcard $(FOLDERS:=/arduino))) \
  $(addprefix -isystem ,$(wildcard $(FOLDERS:=/due/stubs))) --specs=nano.specs -nostartfiles \
  -Wl,--gc-sections,--unresolved-symbols=ignore-all,-e,_Z4loopv,-u,_Z5setupv $(DUE_ENTRIES)
ALL_FILES := $(wildcard $(foreach folder,core host arduino due due/stubs,$(FOLDERS:=/$(folder)/*))) $(MAKEFILES)

cortex-m3: $(BUILD)/due.elf $(BUILD)/$(PIPE)_m3.elf
	$(ARM)size $<
.PHONY: cortex-m3

$(BUILD)/due.elf: $(ALL_FILES)
	@mkdir -p $(BUILD)/due
	cp $(HERE)/due/settings.example.hpp $(BUILD)/due/settings.hpp
	$(ARM)g++ $(ARM_FLAGS) $(DUE_FLAGS) $(CORE) -x c++ $(HERE)/due/due.ino -o $@

$(BUILD)/$(PIPE)_m3.elf: $(ALL_FILES)
	@mkdir -p $(@D)
	$(ARM)g++ -std=c++17 $(ARM_FLAGS) $(addprefix -I,$(wildcard $(FOLDERS:=/host))) $(CORE) $(HOST) \
	  $(HERE)/host/$(PIPE).cpp $(wildcard $(FOLDERS:=/host/cortex_m3.cpp)) \
	  --specs=rdimon.specs -Wl,--section-start=.vectors=0 -o $@
