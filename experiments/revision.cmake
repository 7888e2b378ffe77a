# Writes revision.h, and only if it changes: run at every build.
# In: SOURCE_DIR, OUTPUT, and the CROFTON_* texts that the header repeats.
find_package(Git QUIET)
set(revision "unknown")
set(dirty 0)
if(Git_FOUND)
    execute_process(COMMAND ${GIT_EXECUTABLE} describe --always --tags --abbrev=12
        WORKING_DIRECTORY ${SOURCE_DIR} OUTPUT_VARIABLE described RESULT_VARIABLE failed
        OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
    if(NOT failed)
        set(revision ${described})
        execute_process(COMMAND ${GIT_EXECUTABLE} status --porcelain
            WORKING_DIRECTORY ${SOURCE_DIR} OUTPUT_VARIABLE changes ERROR_QUIET)
        if(changes)
            set(dirty 1)
        endif()
    endif()
endif()
set(text "#pragma once
#define CROFTON_REVISION \"${revision}\"
#define CROFTON_DIRTY ${dirty}
")
set(old "")
if(EXISTS ${OUTPUT})
    file(READ ${OUTPUT} old)
endif()
if(NOT text STREQUAL old)
    file(WRITE ${OUTPUT} "${text}")
endif()
